// What stages `weigh` and `credit` have in common: sums over the gradient rows of a Gaussian.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> first_entries: array<u32>;
// [E, 3] vectors
@group(0) @binding(4) var<storage, read> rows: array<vec4<f32>>;

// Tile lists that a row of the window is in. After an overflow there are no gradient rows; the host repeats all views.
fn entries_of(local: u32) -> u32 {
    if local >= window.count || counters.halted != 0u {
        return 0u;
    }
    return tile_counts[window.first + local] & COUNT_BITS;
}

// dL/drgb of a row that is in so many tile lists; one in none has no first entry either.
fn colour_sum(local: u32, count: u32) -> vec3<f32> {
    var sum = vec3(0.0);
    let first = first_entries[window.first + local];
    for (var entry = first; entry < first + count; entry++) {
        sum += vec3(rows[3u * entry + 1u].zw, rows[3u * entry + 2u].x);
    }
    return sum;
}
