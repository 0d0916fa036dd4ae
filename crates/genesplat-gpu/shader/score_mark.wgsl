// Stage `score`, step 2: which splats of the base an individual does not have, and which tiles it changes.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> items: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> base_counts: array<u32>;
@group(0) @binding(4) var<storage, read> base_splats: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> added_counts: array<u32>;
@group(0) @binding(6) var<storage, read> added_splats: array<vec4<f32>>;
// A bit a row of the base [layers, words].
@group(0) @binding(7) var<storage, read_write> removed: array<atomic<u32>>;
// [layers, tiles]
@group(0) @binding(8) var<storage, read_write> dirty: array<atomic<u32>>;

fn mark(splat: Splat, layer: u32) {
    let tile_rows = tile_rows_of(splat);
    for (var tile_y = tile_rows.x; tile_y < tile_rows.y; tile_y++) {
        let spans = spans_of(splat, tile_y);
        let columns = tile_columns_of(spans);
        for (var tile_x = columns.x; tile_x < columns.y; tile_x++) {
            if reaches(spans, tile_x) {
                atomicStore(&dirty[(layer * frame.tiles_y + tile_y) * frame.tiles_x + u32(tile_x)], 1u);
            }
        }
    }
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.source_count {
        return;
    }
    let row = items[window.source_first + item].x;
    let layer = items[window.source_first + item].y;
    atomicOr(&removed[layer * ((window.count + 31u) / 32u) + row / 32u], 1u << (row % 32u));
    if (base_counts[row] & SPLAT_BIT) != 0u {
        mark(splat_from(base_splats[3u * row], base_splats[3u * row + 1u], base_splats[3u * row + 2u]), layer);
    }
    if (added_counts[item] & SPLAT_BIT) != 0u {
        mark(splat_from(added_splats[3u * item], added_splats[3u * item + 1u], added_splats[3u * item + 2u]), layer);
    }
}
