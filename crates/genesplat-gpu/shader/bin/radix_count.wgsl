// Radix sort, step 1 of each pass: how often each digit occurs in each block of keys `[256, blocks]`.

override LENGTH: u32;
override SHIFT: u32;
// Of what this dispatch sorts.
override FIRST_BLOCK: u32;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> digit_counts: array<u32>;

var<workgroup> counts: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = lengths[LENGTH];
    let blocks = (length + SORT_BLOCK - 1u) / SORT_BLOCK;
    let block = FIRST_BLOCK + group_of(group);
    atomicStore(&counts[lane], 0u);
    workgroupBarrier();
    for (var first = 0u; first < SORT_BLOCK; first += GROUP) {
        let at = block * SORT_BLOCK + first + lane;
        if at < length {
            atomicAdd(&counts[(keys[at] >> SHIFT) & (DIGITS - 1u)], 1u);
        }
    }
    workgroupBarrier();
    if block < blocks {
        digit_counts[lane * blocks + block] = atomicLoad(&counts[lane]);
    }
}
