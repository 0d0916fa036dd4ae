// Stage `project_backward`: from the gradients of a splat's intersections back to its raw parameters, one
// Gaussian an invocation. Exact derivatives of `geometry_of`, step by step in reverse.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> counters: Counters;
@group(0) @binding(3) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> sh: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> splats: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(7) var<storage, read> first_intersections: array<u32>;
// [I, 3] vectors
@group(0) @binding(8) var<storage, read> intersection_gradients: array<vec4<f32>>;
// [N, 4] vectors: position, opacity logit; log-scales, density signal; rotation; colour, weight of the
// density. Rows without a splat are not written, nor read by any stage: that would be most of the memory that
// both touch.
@group(0) @binding(9) var<storage, read_write> gradients: array<vec4<f32>>;

// Adds what the opacity factor of the screen filter contributes to the covariance.
fn filter_gradient(g: Geometry, factor_gradient: f32) -> vec3<f32> {
    var by_raw = 0.0;
    var by_dilated = 0.0;
    if view.filter_kind == FILTER_ANTIALIASED && g.det_raw / g.det > ANTIALIAS_RATIO_MIN {
        by_raw = factor_gradient * 0.5 / g.factor_2d / g.det;
        by_dilated = -by_raw * g.det_raw / g.det;
    } else if view.filter_kind == FILTER_MIP && g.factor_2d > 0.0 {
        by_raw = factor_gradient * 0.5 / (g.factor_2d * (g.det + MIP_EPSILON));
        by_dilated = -by_raw * g.det_raw / (g.det + MIP_EPSILON);
    }
    return vec3(
        by_raw * g.cov_raw.z + by_dilated * g.cov.z,
        -2.0 * (by_raw * g.cov_raw.y + by_dilated * g.cov.y),
        by_raw * g.cov_raw.x + by_dilated * g.cov.x,
    );
}

// dL/d[a, b, c] of the dilated covariance: Q S Q / 2 with S the second moments of p; b counts twice.
fn covariance_gradient(conic: vec3<f32>, second: vec3<f32>) -> vec3<f32> {
    let m00 = conic.x * second.x + conic.y * second.y;
    let m01 = conic.x * second.y + conic.y * second.z;
    let m10 = conic.y * second.x + conic.z * second.y;
    let m11 = conic.y * second.y + conic.z * second.z;
    return vec3(
        0.5 * (m00 * conic.x + m01 * conic.y), m00 * conic.y + m01 * conic.z, 0.5 * (m10 * conic.y + m11 * conic.z));
}

// Through u = J R_view and the mean, with the exact derivative of the Jacobian's clamp: dL/dt in camera
// coordinates.
fn camera_gradient(g: Geometry, u0: vec3<f32>, u1: vec3<f32>, mean_gradient: vec2<f32>) -> vec3<f32> {
    let focal = vec2(view.focal_x, view.focal_y);
    let diagonal = vec2(dot(u0, view.camera_x.xyz), dot(u1, view.camera_y.xyz));
    let third = vec2(dot(u0, view.camera_z.xyz), dot(u1, view.camera_z.xyz));
    let clamped = abs(g.ratio) > vec2(view.limit_x, view.limit_y);
    let by_ratio = select(-third * g.inverse_z * focal, vec2(0.0), clamped) + mean_gradient * focal;
    let by_depth = (third * g.clamped_ratio - diagonal) * (g.inverse_z * g.inverse_z) * focal
        - by_ratio * g.ratio * g.inverse_z;
    return vec3(by_ratio * g.inverse_z, by_depth.x + by_depth.y);
}

// Through R(q) and the normalisation of the quaternion; `d[k]` is dL/d(column k).
fn quaternion_gradient(g: Geometry, d: mat3x3<f32>) -> vec4<f32> {
    let w = g.unit.x; let x = g.unit.y; let y = g.unit.z; let z = g.unit.w;
    // d[column][row]
    let unit = vec4(
        2.0 * (z * (d[0][1] - d[1][0]) + y * (d[2][0] - d[0][2]) + x * (d[1][2] - d[2][1])),
        2.0 * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[1][2] - d[2][1]))
            - 4.0 * x * (d[1][1] + d[2][2]),
        2.0 * (x * (d[0][1] + d[1][0]) + w * (d[2][0] - d[0][2]) + z * (d[1][2] + d[2][1]))
            - 4.0 * y * (d[0][0] + d[2][2]),
        2.0 * (w * (d[0][1] - d[1][0]) + x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]))
            - 4.0 * z * (d[0][0] + d[1][1]),
    );
    return (unit - g.unit * dot(unit, g.unit)) * g.inverse_length;
}

// dL/dposition through the view direction of the colour.
fn colour_position_gradient(local: u32, position: vec3<f32>, rgb_gradient: vec3<f32>) -> vec3<f32> {
    if view.sh_degree == 0u {
        return vec3(0.0);
    }
    let direction = view_direction(position);
    var along = vec3(0.0);
    for (var group = 0u; group < SH_GROUPS; group++) {
        if group < sh_groups(view.sh_degree) {
            let rgb = sh_group(local, group);
            let weights = vec4(
                dot(rgb[0], rgb_gradient), dot(rgb[1], rgb_gradient), dot(rgb[2], rgb_gradient),
                dot(rgb[3], rgb_gradient));
            along += sh_direction_gradient(view.sh_degree, group, direction.xyz, weights);
        }
    }
    // (I - d d^T) / distance: the direction's length is fixed.
    return (along - dot(along, direction.xyz) * direction.xyz) * direction.w;
}

// Sum over the four functions of a group of weights[k] dbasis_k/ddirection (see `sh_basis`).
fn sh_direction_gradient(degree: u32, group: u32, d: vec3<f32>, weights: vec4<f32>) -> vec3<f32> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    switch group {
        case 0u: {
            return SH_C1 * vec3(-weights.w, -weights.y, weights.z);
        }
        case 1u: {
            let a = vec4(SH_C2[0], SH_C2[1], SH_C2[2], SH_C2[3]) * weights;
            return vec3(
                a.x * y - 2.0 * a.z * x + a.w * z, a.x * x + a.y * z - 2.0 * a.z * y,
                a.y * y + 4.0 * a.z * z + a.w * x);
        }
        case 2u: {
            let second = 2.0 * SH_C2[4] * weights.x * vec3(x, -y, 0.0);
            let a = vec3(SH_C3[0], SH_C3[1], SH_C3[2]) * weights.yzw;
            let third = vec3(
                6.0 * a.x * x * y + a.y * y * z - 2.0 * a.z * x * y,
                3.0 * a.x * (xx - yy) + a.y * x * z + a.z * (4.0 * zz - xx - 3.0 * yy),
                a.y * x * y + 8.0 * a.z * y * z);
            return second + select(vec3(0.0), third, degree >= 3u);
        }
        default: {
            let a = vec4(SH_C3[3], SH_C3[4], SH_C3[5], SH_C3[6]) * weights;
            return vec3(
                -6.0 * a.x * x * z + a.y * (4.0 * zz - 3.0 * xx - yy) + 2.0 * a.z * x * z + 3.0 * a.w * (xx - yy),
                -6.0 * a.x * y * z - 2.0 * a.y * x * y - 2.0 * a.z * y * z - 6.0 * a.w * x * y,
                a.x * (6.0 * zz - 3.0 * xx - 3.0 * yy) + 8.0 * a.y * x * z + a.z * (xx - yy));
        }
    }
}

// The density signal of one view, by normalised device coordinate, and its weight where that is not 1:
// pixels.
fn density_of(mean_gradient: vec2<f32>, absolute: vec2<f32>, pixels: f32, depth: f32) -> vec2<f32> {
    let ndc = 0.5 * vec2(f32(view.width), f32(view.height));
    switch view.signal {
        case SIGNAL_SIGNED: { return vec2(length(mean_gradient * ndc), 0.0); }
        case SIGNAL_ABSOLUTE: { return vec2(length(absolute * ndc), 0.0); }
        case SIGNAL_PIXELS: {
            let ratio = depth / view.depth_threshold;
            return vec2(pixels * min(1.0, ratio * ratio) * length(mean_gradient * ndc), pixels);
        }
        default: { return vec2(0.0); }
    }
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    let row = window.first + local;
    var tiles = 0u;
    var first = 0u;
    // After an overflow there are no gradients of intersections; the host repeats the step.
    if local < window.count && counters.halted == 0u {
        tiles = tile_counts[row];
        first = first_intersections[row];
    }
    // 1. Sums over the splat's tiles. What no pixel shows, most of all what is hidden by others, has no
    //    gradients.
    let sums = sums_of_splat(first, tiles & COUNT_BITS, lane);
    if (tiles & SPLAT_BIT) == 0u {
        return;
    }
    let a = sums.a;
    let b = sums.b;
    let c = sums.c;
    if all(a == vec4(0.0)) && all(b == vec4(0.0)) && all(c == vec4(0.0)) {
        for (var i = 0u; i < 4u; i++) {
            gradients[4u * local + i] = vec4(0.0);
        }
        return;
    }
    let first_moments = a.yz;
    let second_moments = vec3(a.w, b.xy);
    var rgb_gradient = vec3(b.zw, c.x);

    // 2. Screen space: conic, mean, inverse-covariance gradient turned into a covariance gradient.
    let params = params_from(geometry[3u * local], geometry[3u * local + 1u], geometry[3u * local + 2u]);
    let g = geometry_of(params);
    let conic = vec3(g.cov.z, -g.cov.y, g.cov.x) / g.det;
    let mean_gradient = vec2(dot(conic.xy, first_moments), dot(conic.yz, first_moments));

    // 3. Opacity, and the screen filter's hold on it.
    let effective_gradient = a.x / g.opacity_effective;
    let cov_gradient = covariance_gradient(conic, second_moments)
        + filter_gradient(g, effective_gradient * g.opacity * g.factor_3d);
    let logit_gradient = effective_gradient * g.factor_3d * g.factor_2d * g.opacity * (1.0 - g.opacity);

    // 4. Covariance = sum over k of variance_k w_k w_k^T; the 3D filter also scales the opacity.
    let variance_gradient =
        cov_gradient.x * g.w0 * g.w0 + cov_gradient.y * g.w0 * g.w1 + cov_gradient.z * g.w1 * g.w1;
    let w0_gradient = g.variance * (2.0 * cov_gradient.x * g.w0 + cov_gradient.y * g.w1);
    let w1_gradient = g.variance * (cov_gradient.y * g.w0 + 2.0 * cov_gradient.z * g.w1);
    var scale_gradient = 2.0 * variance_gradient * g.variance_raw;
    if params.filter_3d > 0.0 {
        scale_gradient += effective_gradient * g.opacity_effective * (1.0 - g.variance_raw / g.variance);
    }

    // 5. w = u R: rotation and u; then camera coordinates.
    let u0_gradient = g.r * w0_gradient;
    let u1_gradient = g.r * w1_gradient;
    let rotation_gradient = quaternion_gradient(g, mat3x3(
        g.u0 * w0_gradient.x + g.u1 * w1_gradient.x,
        g.u0 * w0_gradient.y + g.u1 * w1_gradient.y,
        g.u0 * w0_gradient.z + g.u1 * w1_gradient.z,
    ));
    let t = camera_gradient(g, u0_gradient, u1_gradient, mean_gradient);
    var position_gradient = t.x * view.camera_x.xyz + t.y * view.camera_y.xyz + t.z * view.camera_z.xyz;

    // 6. Colour: no gradient where it was clamped.
    let clamped = bitcast<u32>(splats[3u * row + 2u].w);
    rgb_gradient = select(rgb_gradient, vec3(0.0), (vec3(clamped) & vec3(1u, 2u, 4u)) != vec3(0u));
    if view.centre.w > 0.0 {
        // An inverse depth moves with z, and no colour has a part in it.
        position_gradient -= rgb_gradient.x * view.centre.w * g.inverse_z * g.inverse_z * view.camera_z.xyz;
        rgb_gradient = vec3(0.0);
    } else {
        position_gradient += colour_position_gradient(local, params.position, rgb_gradient);
    }

    let density = density_of(mean_gradient, c.yz, c.w, g.t.z);
    gradients[4u * local] = vec4(position_gradient, logit_gradient);
    gradients[4u * local + 1u] = vec4(scale_gradient, density.x);
    gradients[4u * local + 2u] = rotation_gradient;
    gradients[4u * local + 3u] = vec4(rgb_gradient, density.y);
}
