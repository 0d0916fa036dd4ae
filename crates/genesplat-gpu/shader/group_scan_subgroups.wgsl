// Prefix sum over the 256 invocations of a workgroup, where the device has subgroups: by shuffles in each of them, then over
// their sums. One barrier. Sums saturate as in its twin, `group_scan.wgsl`.

// Where an invocation is in its workgroup. Invocations are numbered by subgroups, since nothing promises that the local index
// is.
struct Place {
    @builtin(subgroup_id) subgroup: u32,
    @builtin(subgroup_invocation_id) seat: u32,
    @builtin(subgroup_size) seats: u32,
}

fn lane_of(place: Place) -> u32 {
    return place.subgroup * place.seats + place.seat;
}

// No subgroup has fewer than four invocations.
var<workgroup> subgroup_sums: array<u32, GROUP / 4u>;
var<private> sum_of_all: u32;

// The sum of `value` over the invocations before this one.
fn exclusive_in_group(place: Place, value: u32) -> u32 {
    var inclusive = value;
    for (var distance = 1u; distance < place.seats; distance *= 2u) {
        let before = subgroupShuffleUp(inclusive, distance);
        if place.seat >= distance {
            inclusive = saturating_add(inclusive, before);
        }
    }
    let exclusive = subgroupShuffleUp(inclusive, 1u);
    if place.seat == place.seats - 1u {
        subgroup_sums[place.subgroup] = inclusive;
    }
    workgroupBarrier();
    var sum = 0u;
    var before = 0u;
    for (var i = 0u; i < GROUP / place.seats; i++) {
        if i == place.subgroup {
            before = sum;
        }
        sum = saturating_add(sum, subgroup_sums[i]);
    }
    sum_of_all = sum;
    if place.seat == 0u {
        return before;
    }
    return saturating_add(before, exclusive);
}

// The sum over all invocations, after `exclusive_in_group`.
fn group_sum() -> u32 {
    return sum_of_all;
}
