// Prefix sum, step 3: within each block, from where the blocks before it end.

override LENGTH: u32;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> input: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> output: array<u32>;

const EACH: u32 = SCAN_BLOCK / GROUP;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = lengths[LENGTH];
    let block = group_of(group);
    let first = block * SCAN_BLOCK + lane * EACH;
    var values: array<u32, EACH>;
    var sum = 0u;
    for (var i = 0u; i < EACH; i++) {
        values[i] = 0u;
        if first + i < length {
            values[i] = input[first + i];
        }
        sum += values[i];
    }
    var prefix = exclusive_in_group(lane, sum);
    if block * SCAN_BLOCK < length {
        prefix += sums[block];
    }
    for (var i = 0u; i < EACH; i++) {
        if first + i < length {
            output[first + i] = prefix;
        }
        prefix += values[i];
    }
}
