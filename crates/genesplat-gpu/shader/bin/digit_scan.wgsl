// Radix sort, step 2 of each pass: where the keys of each block begin among all keys of the same digit, and
// how many keys each digit has. One workgroup a digit; of a single block the first sees to all of them, an
// invocation a digit.

override LENGTH: u32;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
// How often each digit occurs in each block, and in its place where these begin [256, blocks].
@group(0) @binding(1) var<storage, read_write> digit_counts: array<u32>;
// [256]
@group(0) @binding(2) var<storage, read_write> digit_totals: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let blocks = (lengths[LENGTH] + SORT_BLOCK - 1u) / SORT_BLOCK;
    if blocks != 1u {
        scan_in_group(group.x, lane, blocks);
    } else if group.x == 0u {
        digit_totals[lane] = digit_counts[lane];
        digit_counts[lane] = 0u;
    }
}

fn scan_in_group(digit: u32, lane: u32, blocks: u32) {
    var before = 0u;
    for (var first = 0u; first < blocks; first += GROUP) {
        let block = first + lane;
        var count = 0u;
        if block < blocks {
            count = digit_counts[digit * blocks + block];
        }
        let prefix = exclusive_in_group(lane, count);
        if block < blocks {
            digit_counts[digit * blocks + block] = before + prefix;
        }
        before += group_sum();
        workgroupBarrier();
    }
    if lane == 0u {
        digit_totals[digit] = before;
    }
}
