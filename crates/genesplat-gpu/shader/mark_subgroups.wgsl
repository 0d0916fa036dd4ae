// Radix sort: sets the bits of a workgroup's keys in the masks of their digits, by subgroups: equal digits find each other by
// ballots, and one of them writes for all, so that they do not queue for the same word. Twin of `mark.wgsl`.

fn mark(lane: u32, digit: u32, is_key: bool) {
    var equal = subgroupBallot(is_key);
    for (var bit = 1u; bit < DIGITS; bit *= 2u) {
        let is_set = (digit & bit) != 0u;
        let ballot = subgroupBallot(is_set);
        equal &= select(~ballot, ballot, is_set);
    }
    let seat = lane % subgroup_seats();
    let word = equal[seat / 32u];
    let is_first = (word & ((1u << (seat % 32u)) - 1u)) == 0u;
    if is_key && is_first {
        // Several small subgroups share a word of the masks.
        let first_bit = (lane - seat) % 32u;
        atomicOr(&masks[lane / 32u * DIGITS + digit], word << first_bit);
    }
}
