// Do subgroups do here what the kernels that use them rely on? One workgroup; each invocation writes the size
// of its subgroup, or 0 where something is wrong.

@group(0) @binding(0) var<storage, read_write> width_found: array<u32>;

// Bits without a pattern: a ballot in another order, or without some lanes, is another one somewhere.
fn is_marked(lane: u32) -> bool {
    return ((lane * 0x9e3779b9u) & 0x10000u) != 0u;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) lane: u32) {
    let width = subgroup_width();
    let ballot = subgroupBallot(is_marked(lane));
    let before = subgroupShuffleUp(lane, 1u);
    let subgroup_lane = lane % width;
    var expected = vec4(0u);
    for (var other = 0u; other < width; other++) {
        expected[other / 32u] |= u32(is_marked(lane - subgroup_lane + other)) << (other % 32u);
    }
    let is_whole = width >= 4u && width <= 128u && GROUP % width == 0u;
    let is_in_order = subgroup_lane == 0u || before == lane - 1u;
    width_found[lane] = select(0u, width, is_whole && is_in_order && all(ballot == expected));
}
