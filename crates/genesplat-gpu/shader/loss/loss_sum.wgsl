// Stage `loss`, step 2: one loss from the sums of all tiles; ends the step's account.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> sums: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> counters: Counters;

@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) lane: u32) {
    let mean = mean_of_layer(0u, lane);
    if lane != 0u || counters.halted != 0u {
        return;
    }
    let loss = loss_of(mean);
    counters.loss = loss;
    if !is_finite(loss) {
        counters.halted |= HALT_NON_FINITE;
        return;
    }
    counters.step_visible = counters.visible;
    counters.step_intersections = counters.intersections;
    counters.completed += 1u;
}
