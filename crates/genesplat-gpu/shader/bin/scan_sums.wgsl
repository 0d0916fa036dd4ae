// Prefix sum, step 1: the sum of each block of the input.

override LENGTH: u32;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> input: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = lengths[LENGTH];
    let block = group_of(group);
    var sum = 0u;
    for (var i = 0u; i < SCAN_BLOCK / GROUP; i++) {
        let at = block * SCAN_BLOCK + i * GROUP + lane;
        if at < length {
            sum = saturating_add(sum, input[at]);
        }
    }
    exclusive_in_group(lane, sum);
    if lane == 0u && block * SCAN_BLOCK < length {
        sums[block] = group_sum();
    }
}
