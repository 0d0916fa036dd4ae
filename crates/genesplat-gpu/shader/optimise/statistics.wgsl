// Sums for density control, one Gaussian an invocation.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> counters: Counters;
@group(0) @binding(3) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(4) var<storage, read> gradients: array<vec4<f32>>;
// Gradient, weight.
@group(0) @binding(5) var<storage, read_write> density: array<vec2<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count || counters.halted != 0u {
        return;
    }
    // Geometric visibility counts, even where no pixel was touched, as in 3DGS's code.
    let tiles = tile_counts[window.first + local];
    if (tiles & SEEN_BIT) == 0u {
        return;
    }
    var signal = vec2(0.0);
    if (tiles & SPLAT_BIT) != 0u {
        signal = vec2(gradients[4u * local + 1u].w, gradients[4u * local + 3u].w);
    }
    // What lies behind a mask alone would have its mean lowered by views that say nothing of it.
    if view.is_masked != 0u && signal.x == 0.0 {
        return;
    }
    density[local] += vec2(signal.x, select(1.0, signal.y, view.signal == SIGNAL_PIXELS));
}
