// Stage `bin`, step 3: every intersection takes its place in the list of its tile, with the depth of its
// splat.

@group(0) @binding(0) var<storage, read> counters: Counters;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> tiles: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<u32>;
@group(0) @binding(4) var<storage, read> intersection_splats: array<u32>;
// Camera z of each splat, as bits.
@group(0) @binding(5) var<storage, read> depths: array<u32>;
@group(0) @binding(6) var<storage, read_write> list_depths: array<u32>;
@group(0) @binding(7) var<storage, read_write> list_numbers: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let number = group_of(group) * GROUP + lane;
    if number >= counters.intersections {
        return;
    }
    let at = ranges[tiles[number]].x + places[number];
    let row = intersection_splats[number];
    var depth = 0xffffffffu;
    if row != NO_SPLAT {
        depth = depths[row];
    }
    list_depths[at] = depth;
    list_numbers[at] = number;
}
