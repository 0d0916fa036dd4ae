// Stage `contribution`, step 2: adds what the backward blending has summed on one view, one Gaussian an invocation.

// Sums of a Gaussian: its blending weight alone, or its error, too.
override COLUMNS: u32;

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> first_intersections: array<u32>;
// [I, 3] vectors
@group(0) @binding(4) var<storage, read> intersection_gradients: array<vec4<f32>>;
// Blending weight, summed over the views; error, of the view where it is largest [N, COLUMNS].
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
    let of_view = sums_of_splat(first, count, lane).b.zw;
    if count == 0u {
        return;
    }
    let at = COLUMNS * local;
    sums[at] += of_view.x;
    if COLUMNS == 2u {
        sums[at + 1u] = max(sums[at + 1u], of_view.y);
    }
}
