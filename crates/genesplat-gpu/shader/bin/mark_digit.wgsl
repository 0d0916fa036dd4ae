// Radix sort: sets the bits of a workgroup's keys in the masks of their digits. Runs everywhere; twin of
// `mark_digit_subgroups.wgsl`.

fn mark_digit(lane: u32, digit: u32, is_key: bool) {
    if is_key {
        atomicOr(&masks[lane / 32u * DIGITS + digit], 1u << (lane % 32u));
    }
}
