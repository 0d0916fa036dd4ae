// Stage `score`, step 3: one loss and one squared error a layer, from the sums of its tiles; one workgroup a
// layer.

@group(0) @binding(0) var<uniform> view: ViewPass;
// First individual, number of individuals; view, number of views.
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> sums: array<vec4<f32>>;
// Loss and mean squared error [P, V].
@group(0) @binding(3) var<storage, read_write> losses: array<vec2<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let layer = group_of(group);
    let mean = mean_of_layer(layer, lane);
    if lane == 0u && layer < window.count {
        losses[(window.first + layer) * window.source_count + window.source_first] = vec2(loss_of(mean), mean.z);
    }
}
