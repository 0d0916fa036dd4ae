// Stage `bin`, step 4: where the sorted intersections of each tile begin and end. Ranges of empty tiles stay
// as they were cleared: 0 to 0. Begin and end come from different invocations, so they are numbers of their
// own: who writes a component of a vector may write all of it (on Metal).

@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> ranges: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group_of(group) * GROUP + lane;
    let intersections = lengths[LENGTH_INTERSECTIONS];
    if at >= intersections {
        return;
    }
    let tile = keys[at];
    if at == 0u || keys[at - 1u] != tile {
        ranges[2u * tile] = at;
    }
    if at + 1u == intersections || keys[at + 1u] != tile {
        ranges[2u * tile + 1u] = at + 1u;
    }
}
