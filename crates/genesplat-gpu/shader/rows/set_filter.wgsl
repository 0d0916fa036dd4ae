// Replaces Mip-Splatting's 3D filter.

@group(0) @binding(0) var<uniform> window: Window;
// [N]
@group(0) @binding(1) var<storage, read> filter_3d: array<f32>;
@group(0) @binding(2) var<storage, read_write> geometry: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local < window.count {
        geometry[3u * local + 1u].w = filter_3d[window.first + local];
    }
}
