// Stage `adam` of the colours: four floats an invocation, so that neighbours touch neighbouring memory. Runs before the
// positions move, since a coefficient's gradient is its basis function seen from where the Gaussian was rendered.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<uniform> optimiser: Optimiser;
@group(0) @binding(3) var<storage, read> counters: Counters;
@group(0) @binding(4) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> second_moments: array<vec4<f32>>;

// Vectors of a row that hold active coefficients; others have no gradient and no moments yet, so they cannot move.
fn active_vectors() -> u32 {
    if frame.sh_degree == 0u {
        return 1u;
    }
    return 3u * ((frame.sh_degree + 1u) * (frame.sh_degree + 1u) + 3u) / 4u;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    let local = item / 12u;
    let vector = item % 12u;
    if local >= window.count || counters.halted != 0u || vector >= active_vectors() {
        return;
    }
    let rgb = gradients[4u * local + 3u].xyz;
    let direction = view_direction(geometry[3u * local].xyz).xyz;
    let basis = sh_basis(frame.sh_degree, direction);
    var gradient = vec4(0.0);
    var rate = vec4(optimiser.sh_rest);
    for (var k = 0u; k < 4u; k++) {
        let float = 4u * vector + k;
        gradient[k] = basis[float / 3u] * rgb[float % 3u];
        if float < 3u {
            rate[k] = optimiser.sh_dc;
        }
    }
    var m = first_moments[item];
    var v = second_moments[item];
    sh[item] = adam(sh[item], gradient, &m, &v, rate, vec4(optimiser.root));
    first_moments[item] = m;
    second_moments[item] = v;
}
