// Stage `credit`, step 2: adds the gradient rows of one view to credits, one Gaussian an invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> first_entries: array<u32>;
// [E, 3] vectors
@group(0) @binding(4) var<storage, read> rows: array<vec4<f32>>;
// Three mutants, and the number of views, summed over the views [N].
@group(0) @binding(5) var<storage, read_write> credits: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    // After an overflow there are no rows; the host repeats all views.
    if local >= window.count || counters.halted != 0u {
        return;
    }
    let row = window.first + local;
    let count = tile_counts[row] & COUNT_BITS;
    if count == 0u {
        // It has no first entry either.
        return;
    }
    var of_view = vec3(0.0);
    let first = first_entries[row];
    for (var entry = first; entry < first + count; entry++) {
        // dL/drgb.
        of_view += vec3(rows[3u * entry + 1u].zw, rows[3u * entry + 2u].x);
    }
    credits[local] += vec4(of_view, 1.0);
}
