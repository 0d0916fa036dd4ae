// Prefix sum, step 2: one workgroup sums the sums of the blocks before each block; the total comes last.

override LENGTH: u32;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) lane: u32) {
    let blocks = (lengths[LENGTH] + SCAN_BLOCK - 1u) / SCAN_BLOCK;
    var before = 0u;
    for (var first = 0u; first < blocks; first += GROUP) {
        let block = first + lane;
        var value = 0u;
        if block < blocks {
            value = sums[block];
        }
        let prefix = exclusive_in_group(lane, value);
        if block < blocks {
            sums[block] = before + prefix;
        }
        before = saturating_add(before, group_sum());
        workgroupBarrier();
    }
    if lane == 0u {
        sums[blocks] = before;
    }
}
