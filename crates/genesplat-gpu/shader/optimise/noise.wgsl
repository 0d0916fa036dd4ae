// Stage `noise`: SGLD noise of 3DGS-MCMC, noise_scale * sigmoid(-100 (opacity - 0.005)) * covariance * xi,
// after the optimiser's step.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<uniform> optimiser: Optimiser;
@group(0) @binding(2) var<storage, read> counters: Counters;
@group(0) @binding(3) var<storage, read_write> geometry: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count || counters.halted != 0u {
        return;
    }
    let mean = geometry[3u * local];
    let faintness = sigmoid(-NOISE_STEEPNESS * (sigmoid(mean.w) - NOISE_OPACITY));
    if !is_finite(faintness) || faintness <= FAINTNESS_MIN {
        return;
    }
    let key = vec2(optimiser.key_low, optimiser.key_high);
    let xi = normals_at(STREAM_SGLD_NOISE, optimiser.counter, window.first + local, 0u, key);
    let r = unit_rotation(geometry[3u * local + 2u]);
    let scale = exp(geometry[3u * local + 1u].xyz);
    let step = r * (scale * (scale * (xi * r)));
    geometry[3u * local] = vec4(mean.xyz + optimiser.noise_scale * faintness * step, mean.w);
}
