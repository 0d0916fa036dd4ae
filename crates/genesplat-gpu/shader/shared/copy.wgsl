// Copies a memory, a vector an invocation: what a kernel can make of the device's memory.

@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> copy: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group_of(group) * GROUP + lane;
    if at < arrayLength(&source) {
        copy[at] = source[at];
    }
}
