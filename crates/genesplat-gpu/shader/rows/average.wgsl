// Adds a state to the mean of a window's states: mean += (value - mean) / states, four floats an invocation.

override VECTORS: u32;
@group(0) @binding(0) var<uniform> window: Window;
// `amount` is 1 / states.
@group(0) @binding(1) var<uniform> edit: Edit;
@group(0) @binding(2) var<storage, read> values: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> means: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item < window.count * VECTORS {
        means[item] += (values[item] - means[item]) * edit.amount;
    }
}
