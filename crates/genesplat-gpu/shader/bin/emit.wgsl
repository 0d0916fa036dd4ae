// Stage `bin`, step 1: every splat enters the lists of its tiles, one row an invocation. The numbers of its
// intersections follow each other, tile row after tile row. Which numbers it gets depends on who comes first,
// and so does its place in a list. No result depends on either: lists are sorted later (`sort_lists.wgsl`).

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(2) var<storage, read> splats: array<vec4<f32>>;
// `TALLY_` slots, then the length of each tile's list.
@group(0) @binding(3) var<storage, read_write> tallies: array<atomic<u32>>;
// First intersection of each splat.
@group(0) @binding(4) var<storage, read_write> first_intersections: array<u32>;
// Of each intersection its splat, its tile, and its place in that tile's list.
@group(0) @binding(5) var<storage, read_write> intersection_splats: array<u32>;
@group(0) @binding(6) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<u32>;

// Stands for the first intersection of a workgroup whose intersections do not fit.
const NO_ROOM: u32 = 0xffffffffu;

var<workgroup> visible_found: atomic<u32>;
var<workgroup> group_first: u32;
// Splats of so many tiles that one invocation would keep all others waiting: row, first intersection, the one
// after the last.
var<workgroup> wide: array<array<u32, 3>, GROUP>;
var<workgroup> wide_found: atomic<u32>;
var<workgroup> wide_count: u32;

fn splat_of_row(row: u32) -> Splat {
    return splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
}

fn list(at: u32, tile: u32, row: u32) {
    intersection_splats[at] = row;
    tiles[at] = tile;
    places[at] = atomicAdd(&tallies[TALLIES + tile], 1u);
}

// Lists the tiles of a tile row from intersection `first` on, before `end`; returns the one behind them.
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
    let size = vec2(view.tiles_x, view.tiles_y);
    let tile = vec2<u32>(clamp(splat.mean_px / f32(TILE), vec2(0.0), vec2<f32>(size - 1u)));
    for (var at = first; at < end; at += pitch) {
        list(at, tile.y * size.x + tile.x, NO_SPLAT);
    }
}

fn list_splat(row: u32, first: u32, end: u32) {
    let splat = splat_of_row(row);
    let tile_rows = tile_rows_of(splat);
    var at = first;
    for (var tile_y = tile_rows.x; tile_y < tile_rows.y; tile_y++) {
        at = list_row(splat, row, tile_y, at, end);
    }
    list_in_vain(splat, at, end, 1u);
}

// The same by all of a workgroup, a tile row an invocation.
fn list_wide_splat(row: u32, first: u32, end: u32, lane: u32) {
    let splat = splat_of_row(row);
    let tile_rows = tile_rows_of(splat);
    var at = first;
    for (var first_row = tile_rows.x; first_row < tile_rows.y; first_row += GROUP) {
        let tile_y = first_row + lane;
        var count = 0u;
        if tile_y < tile_rows.y {
            count = count_tiles_of_row(splat, tile_y);
        }
        let before = exclusive_in_group(lane, count);
        if count > 0u {
            let row_end = min(at + before + count, end);
            let listed = list_row(splat, row, tile_y, at + before, row_end);
            list_in_vain(splat, listed, row_end, 1u);
        }
        at += group_sum();
    }
    list_in_vain(splat, at + lane, end, GROUP);
}

// Takes so many numbers of intersections for the workgroup; a sum of all that exceeds 32 bits is told of.
fn claim(count: u32) -> u32 {
    let first = atomicAdd(&tallies[TALLY_INTERSECTIONS], count);
    if first > ~count {
        atomicStore(&tallies[TALLY_CARRY], 1u);
    }
    let capacity = view.intersection_capacity;
    return select(NO_ROOM, first, count <= capacity && first <= capacity - count);
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&visible_found, 0u);
        atomicStore(&wide_found, 0u);
    }
    workgroupBarrier();
    // 1. How much is there?
    let row = group_of(group) * GROUP + lane;
    var tile_count = 0u;
    if row < view.rows {
        tile_count = tile_counts[row];
    }
    if (tile_count & SPLAT_BIT) != 0u {
        atomicAdd(&visible_found, 1u);
    }
    let count = tile_count & COUNT_BITS;
    let before = exclusive_in_group(lane, count);
    // 2. Numbers for all of it.
    if lane == 0u {
        group_first = claim(group_sum());
        atomicAdd(&tallies[TALLY_VISIBLE], atomicLoad(&visible_found));
    }
    let first_of_group = workgroupUniformLoad(&group_first);
    if first_of_group == NO_ROOM {
        return;
    }
    // 3. Splats of few tiles, each by its invocation.
    let first = first_of_group + before;
    if count > 0u {
        first_intersections[row] = first;
        if count <= SERIAL_TILES {
            list_splat(row, first, first + count);
        } else {
            wide[atomicAdd(&wide_found, 1u)] = array(row, first, first + count);
        }
    }
    workgroupBarrier();
    // 4. Splats of many tiles, by all.
    if lane == 0u {
        wide_count = atomicLoad(&wide_found);
    }
    let wide_splats = workgroupUniformLoad(&wide_count);
    for (var k = 0u; k < wide_splats; k++) {
        let splat = workgroupUniformLoad(&wide[k]);
        list_wide_splat(splat[0], splat[1], splat[2], lane);
    }
}
