// Gradients of several views for one optimiser step: colours, four coefficients of a row an invocation. Runs
// before the positions move, as `adam_colour` does.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> counters: Counters;
@group(0) @binding(3) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> geometry: array<vec4<f32>>;
// [N, 12] vectors, as of the cloud's colours
@group(0) @binding(5) var<storage, read_write> pending: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> tile_counts: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(workgroup) * GROUP + lane;
    let local = item / SH_GROUPS;
    let group = item % SH_GROUPS;
    if local >= window.count || group >= sh_groups(view.sh_degree) || counters.halted != 0u {
        return;
    }
    if (tile_counts[window.first + local] & SPLAT_BIT) == 0u {
        return;
    }
    let rgb = gradients[4u * local + 3u].xyz;
    let basis = sh_basis(view.sh_degree, group, view_direction(geometry[3u * local].xyz).xyz);
    let at = 3u * item;
    pending[at] += vec4(basis.x * rgb, basis.y * rgb.x);
    pending[at + 1u] += vec4(basis.y * rgb.yz, basis.z * rgb.xy);
    pending[at + 2u] += vec4(basis.z * rgb.z, basis.w * rgb);
}
