// A child of the cloud and its parents: cloud + sum of weight * (parent - cloud), four floats an invocation.

override VECTORS: u32;
@group(0) @binding(0) var<uniform> window: Window;
// For the older and the younger parent: weights of a row's three vectors of geometry, of its first vector of colours, and of
// the others.
@group(0) @binding(1) var<uniform> weights: array<vec4<f32>, 10>;
@group(0) @binding(2) var<storage, read> cloud: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> older: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> younger: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> child: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.count * VECTORS {
        return;
    }
    var kind = item % VECTORS;
    if VECTORS > 3u {
        kind = 3u + min(kind, 1u);
    }
    let base = cloud[item];
    child[item] = base + weights[kind] * (older[item] - base) + weights[5u + kind] * (younger[item] - base);
}
