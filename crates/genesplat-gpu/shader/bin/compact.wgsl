// Stage `bin`, step 1: keys and rows of the splats, in row order, from the prefix sum of their flags.

@group(0) @binding(0) var<storage, read> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> depths: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> rows: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group_of(group) * GROUP + lane;
    if row < lengths[LENGTH_ROWS] && flags[row] == 1u {
        keys[offsets[row]] = depths[row];
        rows[offsets[row]] = row;
    }
}
