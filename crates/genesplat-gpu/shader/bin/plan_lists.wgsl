// Stage `bin`, step 2: where the list of each tile lies, and which lists a workgroup cannot sort at once. One
// workgroup, eight tiles an invocation. Where the lists do not fit, all are empty and the run halts: the host
// finds out, makes room, and repeats what was not done.

// The longest list that the merges after the sort can put together.
override LIST_MAX: u32;
@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> tallies: array<u32>;
@group(0) @binding(2) var<storage, read_write> counters: Counters;
// Begin and end of each tile's list.
@group(0) @binding(3) var<storage, read_write> ranges: array<vec2<u32>>;
// The number of blocks of long lists, then tile and place in its list of each, in any order.
@group(0) @binding(4) var<storage, read_write> blocks: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> grids: array<u32>;

const EACH: u32 = 8u;

var<workgroup> longest: atomic<u32>;
// Blocks of long lists: of all, and of those that are written.
var<workgroup> blocks_counted: atomic<u32>;
var<workgroup> blocks_written: atomic<u32>;
var<workgroup> intersections: u32;

fn write_grid(slot: u32, groups: u32) {
    grids[3u * slot] = min(groups, GRID_WIDTH);
    grids[3u * slot + 1u] = (groups + GRID_WIDTH - 1u) / GRID_WIDTH;
    grids[3u * slot + 2u] = 1u;
}

// Intersections that are listed: all, or none.
fn count_intersections() -> u32 {
    // Where the lists would have more than 32 bits can count, as many as these can.
    let wanted = select(tallies[TALLY_INTERSECTIONS], 0xffffffffu, tallies[TALLY_CARRY] != 0u);
    counters.visible = tallies[TALLY_VISIBLE];
    counters.wanted = max(counters.wanted, wanted);
    if wanted > view.intersection_capacity {
        counters.halted |= HALT_OVERFLOW;
    } else if atomicLoad(&longest) > LIST_MAX {
        counters.halted |= HALT_LONG_LIST;
    }
    counters.intersections = select(wanted, 0u, counters.halted != 0u);
    return counters.intersections;
}

// Blocks of a list that a workgroup cannot sort at once.
fn blocks_of(length: u32) -> u32 {
    return select(0u, (length + LIST_BLOCK - 1u) / LIST_BLOCK, length > LIST_BLOCK);
}

// What follows, once it is known whether the lists fit.
fn write_grids(tiles: u32, listed: u32) {
    let count = select(atomicLoad(&blocks_counted), 0u, listed == 0u);
    blocks[0] = vec2(count, 0u);
    write_grid(GRID_INTERSECTIONS, (listed + GROUP - 1u) / GROUP);
    write_grid(GRID_LISTS, select(tiles + count, 0u, listed == 0u));
    write_grid(GRID_BLOCKS, count);
}

fn length_of(tile: u32, tiles: u32, listed: u32) -> u32 {
    if tile >= tiles || listed == 0u {
        return 0u;
    }
    return tallies[TALLIES + tile];
}

fn write_range(tile: u32, begin: u32, length: u32) {
    ranges[tile] = vec2(begin, begin + length);
    let count = blocks_of(length);
    if count > 0u {
        let first = 1u + atomicAdd(&blocks_written, count);
        for (var place = 0u; place < count; place++) {
            blocks[first + place] = vec2(tile, place);
        }
    }
}

@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) lane: u32) {
    if lane == 0u {
        atomicStore(&longest, 0u);
        atomicStore(&blocks_counted, 0u);
        atomicStore(&blocks_written, 0u);
    }
    workgroupBarrier();
    // 1. Do they fit?
    let tiles = view.tiles_x * view.tiles_y;
    var most = 0u;
    var count = 0u;
    for (var tile = lane; tile < tiles; tile += GROUP) {
        let length = tallies[TALLIES + tile];
        most = max(most, length);
        count += blocks_of(length);
    }
    atomicMax(&longest, most);
    atomicAdd(&blocks_counted, count);
    workgroupBarrier();
    if lane == 0u {
        intersections = count_intersections();
        write_grids(tiles, intersections);
    }
    let listed = workgroupUniformLoad(&intersections);
    // 2. One list after the other.
    var before = 0u;
    for (var first = 0u; first < tiles; first += EACH * GROUP) {
        let first_tile = first + EACH * lane;
        var lengths: array<u32, EACH>;
        var sum = 0u;
        for (var i = 0u; i < EACH; i++) {
            lengths[i] = length_of(first_tile + i, tiles, listed);
            sum += lengths[i];
        }
        var begin = before + exclusive_in_group(lane, sum);
        for (var i = 0u; i < EACH; i++) {
            if first_tile + i < tiles {
                write_range(first_tile + i, begin, lengths[i]);
            }
            begin += lengths[i];
        }
        before += group_sum();
    }
}
