// Stage `project`, step 1: a cloud becomes the splats of one view, one Gaussian an invocation; colours come
// in step 2. Also counts the tiles that each splat reaches.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> geometry: array<vec4<f32>>;
// [N, 3] vectors
@group(0) @binding(3) var<storage, read_write> splats: array<vec4<f32>>;
// Camera z of each splat, as bits: positive floats order as their bits do.
@group(0) @binding(4) var<storage, read_write> depths: array<u32>;
@group(0) @binding(5) var<storage, read_write> tile_counts: array<u32>;

// Step 2 sets it (`bin/colour.wgsl`), after the steps that a row has to make up for.
fn colour_seen(row: u32, position: vec3<f32>) -> vec3<f32> {
    return vec3(0.0);
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count {
        return;
    }
    let params = params_from(geometry[3u * local], geometry[3u * local + 1u], geometry[3u * local + 2u]);
    write_splat(params, local, window.first + local);
}
