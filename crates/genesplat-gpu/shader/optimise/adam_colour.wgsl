// Stage `adam` of the colours: four coefficients an invocation, which are three vectors, so that neighbours touch
// neighbouring memory. Runs before the positions move, since a coefficient's gradient is its basis function seen from
// where the Gaussian was rendered.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<uniform> optimiser: Optimiser;
@group(0) @binding(3) var<storage, read> counters: Counters;
@group(0) @binding(4) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> second_moments: array<vec4<f32>>;

fn step(at: u32, gradient: vec4<f32>, rate: vec4<f32>) {
    var m = first_moments[at];
    var v = second_moments[at];
    sh[at] = adam(sh[at], gradient, &m, &v, rate, vec4(optimiser.root));
    first_moments[at] = m;
    second_moments[at] = v;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(workgroup) * GROUP + lane;
    let local = item / 4u;
    let group = item % 4u;
    // Other groups have no gradient and no moments yet, so they cannot move.
    if local >= window.count || counters.halted != 0u || group >= sh_groups(view.sh_degree) {
        return;
    }
    let rgb = gradients[4u * local + 3u].xyz;
    let basis = sh_basis(view.sh_degree, group, view_direction(geometry[3u * local].xyz).xyz);
    let rest = vec4(optimiser.sh_rest);
    let first = select(rest, vec4(vec3(optimiser.sh_dc), optimiser.sh_rest), group == 0u);
    step(3u * item, vec4(basis.x * rgb, basis.y * rgb.x), first);
    // Nor can these where only the base colour is active.
    if view.sh_degree > 0u {
        step(3u * item + 1u, vec4(basis.y * rgb.yz, basis.z * rgb.xy), rest);
        step(3u * item + 2u, vec4(basis.z * rgb.z, basis.w * rgb), rest);
    }
}
