// Stage `bin` of splats that the host has projected: counts the tiles of each, one splat an invocation.

@group(0) @binding(0) var<uniform> view: ViewPass;
// [N, 3] vectors
@group(0) @binding(1) var<storage, read> splats: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> tile_counts: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let row = group_of(group) * GROUP + lane;
    if row >= view.rows {
        return;
    }
    let splat = splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
    tile_counts[row] = count_tiles(splat) | SPLAT_BIT;
}
