// Stage `bin`, step 3: the intersections of splats with tiles, nearest splat first; the number of an
// intersection is its place here, and never changes.

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

// Splats of so many tiles that one invocation would keep all others waiting: their ranks.
var<workgroup> wide: array<u32, GROUP>;
var<workgroup> wide_found: atomic<u32>;
var<workgroup> wide_count: u32;

fn splat_of_row(row: u32) -> Splat {
    return splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
}

fn list(at: u32, tile: u32, row: u32) {
    keys[at] = tile;
    intersection_splats[at] = row;
}

// Lists the tiles of a tile row from place `first` on, before `end`; returns the place behind them.
fn list_row(splat: Splat, row: u32, tile_y: u32, first: u32, end: u32) -> u32 {
    let spans = spans_of(splat, tile_y);
    let columns = tile_columns_of(spans);
    var at = first;
    for (var tile_x = columns.x; tile_x < columns.y; tile_x++) {
        if reaches(spans, tile_x) && at < end {
            list(at, tile_y * view.tiles_x + u32(tile_x), row);
            at++;
        }
    }
    return at;
}

// Counting shares this code, but a compiler may round differently there. What was counted in vain is listed
// as the splat that reaches nothing, in the tile of the splat's mean: in one tile for all splats, such lists
// could grow long.
fn list_in_vain(splat: Splat, first: u32, end: u32, pitch: u32) {
    let tiles = vec2(view.tiles_x, view.tiles_y);
    let tile = vec2<u32>(clamp(splat.mean_px / f32(TILE), vec2(0.0), vec2<f32>(tiles - 1u)));
    for (var at = first; at < end; at += pitch) {
        list(at, tile.y * tiles.x + tile.x, NO_SPLAT);
    }
}

fn list_splat(rank: u32) {
    let row = order[rank];
    let splat = splat_of_row(row);
    let end = offsets[rank] + counts[rank];
    let tile_rows = tile_rows_of(splat);
    var at = offsets[rank];
    for (var tile_y = tile_rows.x; tile_y < tile_rows.y; tile_y++) {
        at = list_row(splat, row, tile_y, at, end);
    }
    list_in_vain(splat, at, end, 1u);
}

// The same by all of a workgroup, a tile row an invocation.
fn list_wide_splat(rank: u32, lane: u32) {
    let row = order[rank];
    let splat = splat_of_row(row);
    let end = offsets[rank] + counts[rank];
    let tile_rows = tile_rows_of(splat);
    var at = offsets[rank];
    for (var first = tile_rows.x; first < tile_rows.y; first += GROUP) {
        let tile_y = first + lane;
        var count = 0u;
        if tile_y < tile_rows.y {
            count = count_tiles_of_row(splat, tile_y);
        }
        let before = exclusive_in_group(lane, count);
        if count > 0u {
            list_row(splat, row, tile_y, at + before, end);
        }
        at += group_sum();
        workgroupBarrier();
    }
    list_in_vain(splat, at + lane, end, GROUP);
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&wide_found, 0u);
    }
    workgroupBarrier();
    let rank = group_of(group) * GROUP + lane;
    if rank < lengths[LENGTH_VISIBLE] && lengths[LENGTH_INTERSECTIONS] != 0u {
        first_intersections[order[rank]] = offsets[rank];
        if counts[rank] <= SERIAL_TILES {
            list_splat(rank);
        } else {
            wide[atomicAdd(&wide_found, 1u)] = rank;
        }
    }
    workgroupBarrier();
    if lane == 0u {
        wide_count = atomicLoad(&wide_found);
    }
    let wide_splats = workgroupUniformLoad(&wide_count);
    for (var k = 0u; k < wide_splats; k++) {
        list_wide_splat(workgroupUniformLoad(&wide[k]), lane);
    }
}
