// A blend of the cloud and the averages of a window: cloud + sum of weight * (mean - cloud), four floats an invocation.

override VECTORS: u32;
// Floats 4 to 7 of a row end with the 3D filter, which is the cloud's.
override IS_GEOMETRY: bool;
@group(0) @binding(0) var<uniform> window: Window;
// Of the older and of the younger half.
@group(0) @binding(1) var<uniform> weights: vec4<f32>;
@group(0) @binding(2) var<storage, read> cloud: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> older: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> younger: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> blended: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.count * VECTORS {
        return;
    }
    let base = cloud[item];
    var value = base + weights.x * (older[item] - base) + weights.y * (younger[item] - base);
    if IS_GEOMETRY && item % VECTORS == 1u {
        value.w = base.w;
    }
    blended[item] = value;
}
