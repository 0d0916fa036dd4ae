// Stage `bin`, step 4: sorts each tile's list, one list a workgroup, in its memory. Of a list that is longer
// than a block, every block has a workgroup, and the sorted blocks are merged later (`merge_lists.wgsl`).
//
// A bitonic sort in which every comparison orders upwards (Batcher 1968): each round first compares what is
// mirrored about the middle of a part, then what is ever nearer. What would lie behind the end is larger than
// all, stays there, and needs no memory.

// Workgroups of each dispatch but the last.
override GROUPS_EACH: u32;
@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> blocks: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(4) var<storage, read_write> list_depths: array<u32>;
@group(0) @binding(5) var<storage, read_write> list_numbers: array<u32>;
// Numbers of the intersections, tile after tile, nearest first.
@group(0) @binding(6) var<storage, read_write> intersections: array<u32>;
// Which of the dispatches this is.
@group(0) @binding(7) var<uniform> piece: u32;

// First entry and number of entries.
var<workgroup> part: vec2<u32>;
var<workgroup> depths: array<u32, LIST_BLOCK>;
var<workgroup> numbers: array<u32, LIST_BLOCK>;

// What a workgroup sorts: the list of a tile, or a block of a long one.
fn part_of(group: u32, tiles: u32) -> vec2<u32> {
    if group < tiles {
        let range = ranges[group];
        let length = range.y - range.x;
        return vec2(range.x, select(length, 0u, length > LIST_BLOCK));
    }
    if group - tiles >= blocks[0].x {
        return vec2(0u);
    }
    let block = blocks[1u + group - tiles];
    let range = ranges[block.x];
    let first = range.x + block.y * LIST_BLOCK;
    return vec2(first, min(range.y - first, LIST_BLOCK));
}

fn put_in_order(low: u32, high: u32, length: u32) {
    if high >= length {
        return;
    }
    let a = Entry(depths[low], numbers[low]);
    let b = Entry(depths[high], numbers[high]);
    if comes_before(b, a) {
        depths[low] = b.depth;
        numbers[low] = b.number;
        depths[high] = a.depth;
        numbers[high] = a.number;
    }
}

// Pairs of the parts of so many entries, a power of two, that begin before the end.
fn pairs_of(size: u32, length: u32) -> u32 {
    return ((length + size - 1u) & ~(size - 1u)) / 2u;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tiles = view.tiles_x * view.tiles_y;
    let number = piece * GROUPS_EACH + group_of(group);
    if lane == 0u {
        part = part_of(number, tiles);
    }
    let own = workgroupUniformLoad(&part);
    let length = own.y;
    for (var at = lane; at < length; at += GROUP) {
        depths[at] = list_depths[own.x + at];
        numbers[at] = list_numbers[own.x + at];
    }
    workgroupBarrier();
    for (var size = 2u; size < 2u * length; size *= 2u) {
        for (var pair = lane; pair < pairs_of(size, length); pair += GROUP) {
            let place = pair & (size / 2u - 1u);
            let first = 2u * (pair - place);
            put_in_order(first + place, first + size - 1u - place, length);
        }
        workgroupBarrier();
        for (var distance = size / 4u; distance > 0u; distance /= 2u) {
            for (var pair = lane; pair < pairs_of(2u * distance, length); pair += GROUP) {
                let low = 2u * pair - (pair & (distance - 1u));
                put_in_order(low, low + distance, length);
            }
            workgroupBarrier();
        }
    }
    for (var at = lane; at < length; at += GROUP) {
        if number < tiles {
            intersections[own.x + at] = numbers[at];
        } else {
            list_depths[own.x + at] = depths[at];
            list_numbers[own.x + at] = numbers[at];
        }
    }
}
