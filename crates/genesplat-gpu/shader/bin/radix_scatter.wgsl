// Radix sort, step 3 of each pass: every key to its place, keys of equal digits in their old order.
//
// A workgroup takes 256 keys at a time. Each invocation sets its bit in the mask of its digit; the bits below
// it are the equal digits before it. This needs no promise about the order of workgroups.

override LENGTH: u32;
override SHIFT: u32;
// Of what this dispatch sorts.
override FIRST_BLOCK: u32;
// The values are the places of the keys before the first pass.
override COUNT_UP: bool;
@group(0) @binding(0) var<storage, read> lengths: array<u32>;
// Where each block begins among the keys of a digit [256, blocks], and the numbers of these keys [256].
@group(0) @binding(1) var<storage, read> digit_starts: array<u32>;
@group(0) @binding(2) var<storage, read> digit_totals: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<u32>;
@group(0) @binding(4) var<storage, read> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

const WORDS: u32 = GROUP / 32u;
// Word by word, so that neighbours in a workgroup, each of whom keeps one digit, are neighbours in memory.
var<workgroup> masks: array<atomic<u32>, WORDS * DIGITS>;
var<workgroup> next: array<u32, DIGITS>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let length = lengths[LENGTH];
    let blocks = (length + SORT_BLOCK - 1u) / SORT_BLOCK;
    let block = FIRST_BLOCK + group_of(group);
    if block >= blocks {
        return;
    }
    // Behind all keys of smaller digits.
    next[lane] = exclusive_in_group(lane, digit_totals[lane]) + digit_starts[lane * blocks + block];
    for (var word = 0u; word < WORDS; word++) {
        atomicStore(&masks[word * DIGITS + lane], 0u);
    }
    workgroupBarrier();
    // The last block may be short.
    let rounds = (min(length - block * SORT_BLOCK, SORT_BLOCK) + GROUP - 1u) / GROUP;
    for (var i = 0u; i < rounds; i++) {
        let at = block * SORT_BLOCK + i * GROUP + lane;
        var key = 0u;
        var digit = 0u;
        if at < length {
            key = keys[at];
            digit = (key >> SHIFT) & (DIGITS - 1u);
        }
        mark_digit(lane, digit, at < length);
        workgroupBarrier();
        if at < length {
            let own = atomicLoad(&masks[lane / 32u * DIGITS + digit]);
            var place = next[digit] + countOneBits(own & ((1u << (lane % 32u)) - 1u));
            for (var word = 0u; word < WORDS; word++) {
                if word < lane / 32u {
                    place += countOneBits(atomicLoad(&masks[word * DIGITS + digit]));
                }
            }
            keys_out[place] = key;
            if COUNT_UP {
                values_out[place] = at;
            } else {
                values_out[place] = values[at];
            }
        }
        workgroupBarrier();
        var count = 0u;
        for (var word = 0u; word < WORDS; word++) {
            count += countOneBits(atomicExchange(&masks[word * DIGITS + lane], 0u));
        }
        next[lane] += count;
        workgroupBarrier();
    }
}
