// Stage `bin`, step 3: the intersections of splats with tiles, nearest splat first; the number of an intersection is
// its place here, and never changes.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> lengths: array<u32>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> offsets: array<u32>;
@group(0) @binding(5) var<storage, read> splats: array<vec4<f32>>;
// Tile of each intersection.
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;
// Splat of each intersection.
@group(0) @binding(7) var<storage, read_write> intersection_splats: array<u32>;
// First intersection of each splat.
@group(0) @binding(8) var<storage, read_write> first_intersections: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let rank = group_of(group) * GROUP + lane;
    if rank >= lengths[LENGTH_VISIBLE] || lengths[LENGTH_INTERSECTIONS] == 0u {
        return;
    }
    let row = order[rank];
    let splat = splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
    var at = offsets[rank];
    let end = at + counts[rank];
    first_intersections[row] = at;
    let tile_rows = tile_rows_of(splat);
    var tile = min(tile_rows.x, view.tiles_y - 1u) * view.tiles_x;
    for (var tile_y = tile_rows.x; tile_y < tile_rows.y; tile_y++) {
        let spans = spans_of(splat, tile_y);
        let columns = tile_columns_of(spans);
        for (var tile_x = columns.x; tile_x < columns.y; tile_x++) {
            if reaches(spans, tile_x) && at < end {
                tile = tile_y * view.tiles_x + u32(tile_x);
                keys[at] = tile;
                intersection_splats[at] = row;
                at++;
            }
        }
    }
    // Counting shares this code, but a compiler may round differently there. What was counted in vain is listed as the
    // splat that reaches nothing, in the splat's last tile: in one tile for all splats, such lists could grow long.
    for (; at < end; at++) {
        keys[at] = tile;
        intersection_splats[at] = NO_SPLAT;
    }
}
