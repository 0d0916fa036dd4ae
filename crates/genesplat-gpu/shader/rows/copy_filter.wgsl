// Gives a mean of states the cloud's 3D filter, one Gaussian an invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> cloud: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> mean: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local < window.count {
        mean[3u * local + 1u].w = cloud[3u * local + 1u].w;
    }
}
