// Radix sort: sets the bits of a workgroup's keys in the masks of their digits, by subgroups: equal digits
// find each other by ballots, and one of them writes for all, so that they do not queue for the same word.
// Twin of `mark_digit.wgsl`.

fn mark_digit(lane: u32, digit: u32, is_key: bool) {
    var equal = subgroupBallot(is_key);
    for (var bit = 1u; bit < DIGITS; bit *= 2u) {
        let is_set = (digit & bit) != 0u;
        let ballot = subgroupBallot(is_set);
        equal &= select(~ballot, ballot, is_set);
    }
    let subgroup_lane = lane % subgroup_width();
    let word = equal[subgroup_lane / 32u];
    let is_first = (word & ((1u << (subgroup_lane % 32u)) - 1u)) == 0u;
    if is_key && is_first {
        // Several small subgroups share a word of the masks.
        let first_bit = (lane - subgroup_lane) % 32u;
        atomicOr(&masks[lane / 32u * DIGITS + digit], word << first_bit);
    }
}
