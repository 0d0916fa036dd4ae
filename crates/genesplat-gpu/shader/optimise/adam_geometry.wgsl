// Stage `adam` of positions, scales, rotations and opacities, with MCMC's regularisers before it. Dense, as
// published: rows without a gradient still move by their momentum.

// 1: rows without a splat have gradients, too, those of other views.
override ALL_ROWS: u32;
@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<uniform> optimiser: Optimiser;
@group(0) @binding(3) var<storage, read> counters: Counters;
@group(0) @binding(4) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> geometry: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> second_moments: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> tile_counts: array<u32>;

// What is not known is none.
fn gradient(at: u32, is_known: bool) -> vec4<f32> {
    if is_known {
        return gradients[at];
    }
    return vec4(0.0);
}

fn step(at: u32, gradient: vec4<f32>, rate: vec4<f32>, root: vec4<f32>, keep: vec4<bool>) {
    var m = first_moments[at];
    var v = second_moments[at];
    let old = geometry[at];
    let moved = adam(old, gradient, &m, &v, rate, root);
    geometry[at] = select(moved, old, keep);
    first_moments[at] = select(m, first_moments[at], keep);
    second_moments[at] = select(v, second_moments[at], keep);
}

// Shortens what has moved a Gaussian farther than its reach from where it was before.
fn limit_position(row: u32, before: vec3<f32>) {
    let after = geometry[3u * row];
    let change = after.xyz - before;
    let log_scale = geometry[3u * row + 1u].xyz;
    let deviations = (change * unit_rotation(geometry[3u * row + 2u])) * exp(-log_scale);
    let length = sqrt(dot(deviations, deviations));
    if length > optimiser.position_reach {
        geometry[3u * row] = vec4(before + optimiser.position_reach / length * change, after.w);
    }
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count || counters.halted != 0u {
        return;
    }
    let is_known = ALL_ROWS == 1u || (tile_counts[window.first + local] & SPLAT_BIT) != 0u;
    var position = gradient(4u * local, is_known);
    var scale = gradient(4u * local + 1u, is_known);
    if optimiser.is_mcmc == 1u {
        // Means over the cloud of opacities and scales, as parts of the loss.
        let opacity = sigmoid(geometry[3u * local].w);
        let log_scale = geometry[3u * local + 1u];
        let rows = f32(view.rows);
        position.w += optimiser.opacity_weight / rows * opacity * (1.0 - opacity);
        scale += vec4(exp(log_scale.xyz) * (optimiser.scale_weight / (3.0 * rows)), 0.0);
    }
    let root = vec4(optimiser.root);
    let before = geometry[3u * local].xyz;
    let keep_opacity = optimiser.opacity_root == 0.0;
    step(
        3u * local, position, vec4(vec3(optimiser.position), optimiser.opacity),
        vec4(root.xyz, optimiser.opacity_root), vec4(false, false, false, keep_opacity));
    if optimiser.position_reach > 0.0 {
        limit_position(local, before);
    }
    // The 3D filter is no parameter.
    step(3u * local + 1u, scale, vec4(optimiser.scale), root, vec4(false, false, false, true));
    let rotation = gradient(4u * local + 2u, is_known);
    step(3u * local + 2u, rotation, vec4(optimiser.rotation), root, vec4(false));
}
