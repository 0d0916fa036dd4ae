// Stage `loss`, step 2: one loss from the sums of all tiles; ends the step's account.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> sums: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> counters: Counters;

var<workgroup> totals: array<vec4<f32>, GROUP>;

@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) lane: u32) {
    let blocks = 3u * frame.tiles_x * frame.tiles_y;
    var sum = vec4(0.0);
    for (var at = lane; at < blocks; at += GROUP) {
        sum += sums[at];
    }
    totals[lane] = sum;
    workgroupBarrier();
    if lane != 0u || counters.halted != 0u {
        return;
    }
    var total = vec4(0.0);
    for (var i = 0u; i < GROUP; i++) {
        total += totals[i];
    }
    let mean = total / f32(3u * frame.width * frame.height);
    let loss = (1.0 - LAMBDA_DSSIM) * mean.x + LAMBDA_DSSIM * (1.0 - mean.y);
    counters.loss = loss;
    if !is_finite(loss) {
        counters.halted |= HALT_NON_FINITE;
        return;
    }
    counters.step_visible = counters.visible;
    counters.step_entries = counters.entries;
    counters.completed += 1u;
}
