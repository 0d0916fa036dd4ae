// Stage `adam` of the colours from the gradients of several views, of which it leaves zeros; one vector an
// invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<uniform> optimiser: Optimiser;
@group(0) @binding(2) var<storage, read> counters: Counters;
// [N, 12] vectors each
@group(0) @binding(3) var<storage, read_write> pending: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> second_moments: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group_of(group) * GROUP + lane;
    if at >= VECTORS * window.count || counters.halted != 0u {
        return;
    }
    let rate = colour_rate(at, optimiser.sh_dc, optimiser.sh_rest);
    var m = first_moments[at];
    var v = second_moments[at];
    sh[at] = adam(sh[at], pending[at], &m, &v, rate, vec4(optimiser.root));
    first_moments[at] = m;
    second_moments[at] = v;
    pending[at] = vec4(0.0);
}
