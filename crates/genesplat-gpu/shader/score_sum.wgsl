// Stage `score`, step 4: one loss and one squared error a layer, from the sums of its tiles; one workgroup a layer.

@group(0) @binding(0) var<uniform> frame: Frame;
// First individual of the batch, number of individuals; view, number of views.
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> sums: array<vec4<f32>>;
// Loss and mean squared error [P, V].
@group(0) @binding(3) var<storage, read_write> judgements: array<vec2<f32>>;

var<workgroup> totals: array<vec4<f32>, GROUP>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let layer = group_of(group);
    let blocks = 3u * frame.tiles_x * frame.tiles_y;
    var sum = vec4(0.0);
    for (var at = lane; at < blocks; at += GROUP) {
        sum += sums[layer * blocks + at];
    }
    totals[lane] = sum;
    workgroupBarrier();
    if lane != 0u || layer >= window.count {
        return;
    }
    var total = vec4(0.0);
    for (var i = 0u; i < GROUP; i++) {
        total += totals[i];
    }
    let mean = total / f32(3u * frame.width * frame.height);
    judgements[(window.first + layer) * window.source_count + window.source_first] =
        vec2((1.0 - LAMBDA_DSSIM) * mean.x + LAMBDA_DSSIM * (1.0 - mean.y), mean.z);
}
