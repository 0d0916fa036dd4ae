// Gradients of several views for one optimiser step: positions, scales, rotations, opacities; one Gaussian an
// invocation.

// 1: the step is made, so the sum takes the place of every row's gradients, and zeros are left; 0: it waits.
override TAKE: u32;
@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read_write> gradients: array<vec4<f32>>;
// [N, 3] vectors, as of the cloud's geometry
@group(0) @binding(3) var<storage, read_write> pending: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> tile_counts: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count || counters.halted != 0u {
        return;
    }
    let has_gradients = (tile_counts[window.first + local] & SPLAT_BIT) != 0u;
    for (var i = 0u; i < 3u; i++) {
        var gradient = vec4(0.0);
        if has_gradients {
            gradient = gradients[4u * local + i];
        }
        // The fourth number of the scales is the density signal, and no gradient.
        let sum = pending[3u * local + i] + vec4(gradient.xyz, select(gradient.w, 0.0, i == 1u));
        if TAKE == 1u {
            gradients[4u * local + i] = sum;
            pending[3u * local + i] = vec4(0.0);
        } else {
            pending[3u * local + i] = sum;
        }
    }
}
