// Stage `score`, step 1: the changed Gaussians of a batch of individuals, one an invocation, become splats of their own.
// Colour, rotation and 3D filter are the base's.

@group(0) @binding(0) var<uniform> frame: Frame;
// The rows of the base that are in sight, and the items of the batch.
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sh: array<vec4<f32>>;
// Row and layer of each item.
@group(0) @binding(4) var<storage, read> items: array<vec2<u32>>;
// [K, 2] vectors: position, opacity logit; log-scales, nothing.
@group(0) @binding(5) var<storage, read> genes: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> splats: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> depths: array<u32>;
@group(0) @binding(8) var<storage, read_write> tile_counts: array<u32>;
@group(0) @binding(9) var<storage, read_write> marks: array<u32>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.source_count {
        return;
    }
    let at = window.source_first + item;
    let row = items[at].x - window.first;
    // Unsigned: rows before the window wrap to large numbers.
    if row >= window.count {
        return;
    }
    let scale = vec4(genes[2u * at + 1u].xyz, geometry[3u * row + 1u].w);
    let params = params_from(genes[2u * at], scale, geometry[3u * row + 2u]);
    write_splat(params, row, items[at].y, item);
}
