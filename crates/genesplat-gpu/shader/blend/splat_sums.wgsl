// What the backward blending has summed of each splat, for a host that goes on from there; one splat an
// invocation.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> first_intersections: array<u32>;
// [I, 3] vectors
@group(0) @binding(4) var<storage, read> intersection_gradients: array<vec4<f32>>;
// [N, 3] vectors
@group(0) @binding(5) var<storage, read_write> sums: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group_of(group) * GROUP + lane;
    var count = 0u;
    var first = 0u;
    // After an overflow there are no gradients; the host repeats the view.
    if row < view.rows && counters.halted == 0u {
        count = tile_counts[row] & COUNT_BITS;
        first = first_intersections[row];
    }
    let of_splat = sums_of_splat(first, count, lane);
    if row < view.rows {
        sums[3u * row] = of_splat.a;
        sums[3u * row + 1u] = of_splat.b;
        sums[3u * row + 2u] = of_splat.c;
    }
}
