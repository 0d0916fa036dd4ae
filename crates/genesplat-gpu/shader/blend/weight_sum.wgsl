// Stage `blending_weights`: adds what the backward blending has summed for red on one view, one Gaussian an
// invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> first_intersections: array<u32>;
// [I, 3] vectors
@group(0) @binding(4) var<storage, read> intersection_gradients: array<vec4<f32>>;
// Blending weights times the map [N].
@group(0) @binding(5) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    var count = 0u;
    var first = 0u;
    // After an overflow there are no gradients; the host repeats all views.
    if local < window.count && counters.halted == 0u {
        count = tile_counts[window.first + local] & COUNT_BITS;
        first = first_intersections[window.first + local];
    }
    let of_view = sums_of_splat(first, count, lane).b.z;
    if count > 0u {
        sums[local] += of_view;
    }
}
