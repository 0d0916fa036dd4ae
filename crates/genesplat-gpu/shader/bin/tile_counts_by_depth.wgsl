// Stage `bin`, step 2: the numbers of tiles, nearest splat first.

@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let rank = group_of(group) * GROUP + lane;
    if rank < lengths[LENGTH_VISIBLE] {
        counts[rank] = tile_counts[order[rank]] & COUNT_BITS;
    }
}
