// Radix sort: sets the bits of a workgroup's keys in the masks of their digits. Runs everywhere; twin of `mark_subgroups.wgsl`.

fn mark(place: Place, digit: u32, is_key: bool) {
    let lane = lane_of(place);
    if is_key {
        atomicOr(&masks[lane / 32u * DIGITS + digit], 1u << (lane % 32u));
    }
}
