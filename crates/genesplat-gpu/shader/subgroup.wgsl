// How large subgroups are. Counted by a ballot, so that a kernel's arguments are the same with and without subgroups. Kernels take
// it that a subgroup's invocations are neighbours and that ballots have them all, in order: `probe_subgroups.wgsl` finds out
// whether they may.

// All invocations of the workgroup must ask.
fn subgroup_seats() -> u32 {
    let counts = countOneBits(subgroupBallot(true));
    return counts.x + counts.y + counts.z + counts.w;
}
