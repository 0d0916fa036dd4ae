// The order of a tile's list: by depth, then by row, as on the CPU. Needs `intersection_splats`.

struct Entry {
    // Bits of a positive number order as it does.
    depth: u32,
    // Of the intersection.
    number: u32,
}

// Whether `a` comes before `b`. No two entries are alike, so that the order does not depend on how they came.
fn comes_before(a: Entry, b: Entry) -> bool {
    if a.depth != b.depth {
        return a.depth < b.depth;
    }
    let a_row = intersection_splats[a.number];
    let b_row = intersection_splats[b.number];
    // Splats that reach nothing may be in a list more than once.
    return a_row < b_row || (a_row == b_row && a.number < b.number);
}
