// How wide subgroups are. Counted by a ballot, so that a kernel's arguments are the same with and without
// subgroups. Kernels rely on a subgroup's invocations being neighbours and on ballots having all of them, in
// order: `probe_subgroups.wgsl` tests both.

// All invocations of the workgroup must ask.
fn subgroup_width() -> u32 {
    let counts = countOneBits(subgroupBallot(true));
    return counts.x + counts.y + counts.z + counts.w;
}
