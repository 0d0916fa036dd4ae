// Exchanges two clouds, four floats an invocation; the 3D filter stays where it is.

override VECTORS: u32;
// The vector of a row whose last float is the 3D filter; one beyond all where there is none.
override FILTER_VECTOR: u32;
@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read_write> ours: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> theirs: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.count * VECTORS {
        return;
    }
    var a = ours[item];
    var b = theirs[item];
    if item % VECTORS == FILTER_VECTOR {
        let filter_3d = a.w;
        a.w = b.w;
        b.w = filter_3d;
    }
    ours[item] = b;
    theirs[item] = a;
}
