// Prefix sum over the 256 invocations of a workgroup, by subgroups: shuffles in each of them, then a walk
// over their sums. One barrier. Sums saturate as in its twin, `group_scan.wgsl`.

// No subgroup has fewer than four invocations.
var<workgroup> subgroup_sums: array<u32, GROUP / 4u>;
var<private> sum_of_all: u32;

// The sum of `value` over the invocations before `lane`.
fn exclusive_in_group(lane: u32, value: u32) -> u32 {
    let width = subgroup_width();
    let subgroup_lane = lane % width;
    var inclusive = value;
    for (var distance = 1u; distance < width; distance *= 2u) {
        let before = subgroupShuffleUp(inclusive, distance);
        if subgroup_lane >= distance {
            inclusive = saturating_add(inclusive, before);
        }
    }
    let exclusive = select(subgroupShuffleUp(inclusive, 1u), 0u, subgroup_lane == 0u);
    if subgroup_lane == width - 1u {
        subgroup_sums[lane / width] = inclusive;
    }
    workgroupBarrier();
    var sum = 0u;
    var before = 0u;
    for (var i = 0u; i < GROUP / width; i++) {
        before = select(before, sum, i == lane / width);
        sum = saturating_add(sum, subgroup_sums[i]);
    }
    sum_of_all = sum;
    return saturating_add(before, exclusive);
}

// The sum over all invocations, after `exclusive_in_group`.
fn group_sum() -> u32 {
    return sum_of_all;
}
