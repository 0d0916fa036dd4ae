// Stage `bin`, step 5, of lists that are longer than a block: merges up to 32 sorted runs of a list into one,
// a block of entries a workgroup. The place of an entry is its place in its own run, and in each of the other
// runs the number of entries that come before it, by bisection.

// Entries of a run.
override RUN: u32;
// Workgroups of each dispatch but the last.
override GROUPS_EACH: u32;
@group(0) @binding(0) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read> blocks: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(3) var<storage, read> list_depths: array<u32>;
@group(0) @binding(4) var<storage, read> list_numbers: array<u32>;
@group(0) @binding(5) var<storage, read_write> merged_depths: array<u32>;
@group(0) @binding(6) var<storage, read_write> merged_numbers: array<u32>;
// Numbers of the intersections, tile after tile, nearest first.
@group(0) @binding(7) var<storage, read_write> intersections: array<u32>;
// Which of the dispatches this is.
@group(0) @binding(8) var<uniform> piece: u32;

fn entry_at(at: u32) -> Entry {
    return Entry(list_depths[at], list_numbers[at]);
}

// Entries in [first, end), which is sorted, that come before one that is elsewhere.
fn count_before(entry: Entry, first: u32, end: u32) -> u32 {
    var low = first;
    var high = end;
    while low < high {
        let middle = low + (high - low) / 2u;
        if comes_before(entry_at(middle), entry) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low - first;
}

// The entry at a place of a list that lies from `begin` on.
fn move_entry(begin: u32, length: u32, at: u32) {
    let merged = RUNS * RUN;
    let first = at / merged * merged;
    let end = min(first + merged, length);
    let own_run = at / RUN * RUN;
    let entry = entry_at(begin + at);
    var place = begin + first + at - own_run;
    for (var run = first; run < end; run += RUN) {
        if run != own_run {
            place += count_before(entry, begin + run, begin + min(run + RUN, end));
        }
    }
    if merged >= length {
        intersections[place] = entry.number;
    } else {
        merged_depths[place] = entry.depth;
        merged_numbers[place] = entry.number;
    }
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let number = piece * GROUPS_EACH + group_of(group);
    if number >= blocks[0].x {
        return;
    }
    let block = blocks[1u + number];
    let range = ranges[block.x];
    let length = range.y - range.x;
    // Shorter lists are done.
    if length <= RUN {
        return;
    }
    let first = block.y * LIST_BLOCK;
    for (var at = first + lane; at < min(first + LIST_BLOCK, length); at += GROUP) {
        move_entry(range.x, length, at);
    }
}
