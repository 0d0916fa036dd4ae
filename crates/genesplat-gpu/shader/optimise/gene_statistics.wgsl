// Sums of signed gene gradients for evolution, one Gaussian an invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> gradients: array<vec4<f32>>;
// [N, 2] vectors: position and x of the log-scale; its y and z, opacity logit, number of views.
@group(0) @binding(4) var<storage, read_write> genes: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count || counters.halted != 0u {
        return;
    }
    if (tile_counts[window.first + local] & SPLAT_BIT) == 0u {
        return;
    }
    let position = gradients[4u * local];
    let scale = gradients[4u * local + 1u];
    genes[2u * local] += vec4(position.xyz, scale.x);
    // A number of views is exact in f32 up to 16 million.
    genes[2u * local + 1u] += vec4(scale.yz, position.w, 1.0);
}
