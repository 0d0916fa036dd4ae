// Steps 1 to 5 of the projection: everything between raw parameters and the screen. The backward pass
// computes it again rather than reading hundreds of bytes a Gaussian. Formulas: 3DGS, section 4 and appendix
// A; Zwicker et al. 2001.

struct Params {
    position: vec3<f32>,
    opacity_logit: f32,
    log_scale: vec3<f32>,
    // Standard deviation of Mip-Splatting's 3D filter; 0 without one.
    filter_3d: f32,
    // (w, x, y, z)
    rotation: vec4<f32>,
}

struct Geometry {
    // A parameter is NaN, which the limits in what follows may have turned into any number.
    has_nan_parameter: bool,
    inverse_length: f32,
    unit: vec4<f32>,
    // Columns are the own axes in world coordinates.
    r: mat3x3<f32>,
    variance_raw: vec3<f32>,
    variance: vec3<f32>,
    // Mean in camera coordinates.
    t: vec3<f32>,
    inverse_z: f32,
    ratio: vec2<f32>,
    clamped_ratio: vec2<f32>,
    // Rows of J R_view, and those times R.
    u0: vec3<f32>,
    u1: vec3<f32>,
    w0: vec3<f32>,
    w1: vec3<f32>,
    // [a, b, c] before and after the screen filter, px^2.
    cov_raw: vec3<f32>,
    cov: vec3<f32>,
    det_raw: f32,
    det: f32,
    factor_3d: f32,
    factor_2d: f32,
    opacity: f32,
    opacity_effective: f32,
}

fn params_from(a: vec4<f32>, b: vec4<f32>, c: vec4<f32>) -> Params {
    return Params(a.xyz, a.w, b.xyz, b.w, c);
}

// Factor on the opacity that keeps a splat's energy under the screen filter.
fn screen_factor(det_raw: f32, det: f32) -> f32 {
    if view.filter_kind == FILTER_ANTIALIASED {
        return sqrt(max(det_raw / det, ANTIALIAS_RATIO_MIN));
    }
    if view.filter_kind == FILTER_MIP {
        if det_raw <= MIP_EPSILON || det <= MIP_EPSILON {
            return 0.0;
        }
        return sqrt(det_raw / (det + MIP_EPSILON) + MIP_EPSILON);
    }
    return 1.0;
}

fn geometry_of(p: Params) -> Geometry {
    var g: Geometry;
    g.has_nan_parameter = has_nan(vec4(p.position, p.opacity_logit)) || has_nan(vec4(p.log_scale, p.filter_3d))
        || has_nan(p.rotation);
    // 1. Own axes: rotation of the unit quaternion, variances with the 3D filter.
    g.inverse_length = 1.0 / max(sqrt(dot(p.rotation, p.rotation)), 1e-12);
    g.unit = p.rotation * g.inverse_length;
    g.r = rotation_matrix(g.unit);
    g.variance_raw = vec3(
        exp_limited(2.0 * p.log_scale.x), exp_limited(2.0 * p.log_scale.y), exp_limited(2.0 * p.log_scale.z));
    g.variance = g.variance_raw + p.filter_3d * p.filter_3d;

    // 2. Camera coordinates.
    g.t = vec3(
        dot(p.position, view.camera_x.xyz) + view.camera_x.w,
        dot(p.position, view.camera_y.xyz) + view.camera_y.w,
        dot(p.position, view.camera_z.xyz) + view.camera_z.w,
    );
    g.inverse_z = 1.0 / g.t.z;

    // 3. Jacobian of the projection, with x/z and y/z clamped.
    let limit = vec2(view.limit_x, view.limit_y);
    g.ratio = g.t.xy * g.inverse_z;
    g.clamped_ratio = min(max(g.ratio, -limit), limit);
    let diagonal = g.inverse_z * vec2(view.focal_x, view.focal_y);
    let third = -diagonal * g.clamped_ratio;
    g.u0 = diagonal.x * view.camera_x.xyz + third.x * view.camera_z.xyz;
    g.u1 = diagonal.y * view.camera_y.xyz + third.y * view.camera_z.xyz;

    // 4. Covariance on the screen: sum over the own axes of variance * w w^T.
    g.w0 = g.u0 * g.r;
    g.w1 = g.u1 * g.r;
    g.cov_raw = vec3(
        dot(g.variance * g.w0, g.w0), dot(g.variance * g.w0, g.w1), dot(g.variance * g.w1, g.w1));
    g.cov = g.cov_raw + vec3(view.dilation, 0.0, view.dilation);
    // As a sum of squares (Cauchy and Binet): xx yy - xy^2 of a needle is a small difference of large
    // numbers.
    let minors = cross(g.w0, g.w1);
    g.det_raw = dot(minors * minors, g.variance.yzx * g.variance.zxy);
    g.det = g.det_raw + view.dilation * (g.cov_raw.x + g.cov_raw.z) + view.dilation * view.dilation;

    // 5. Opacity, with what the filters take from it.
    g.opacity = sigmoid(p.opacity_logit);
    let ratio = g.variance_raw / g.variance;
    g.factor_3d = select(1.0, sqrt(ratio.x * ratio.y * ratio.z), p.filter_3d > 0.0);
    g.factor_2d = screen_factor(g.det_raw, g.det);
    g.opacity_effective = g.opacity * g.factor_3d * g.factor_2d;
    return g;
}

// In front of the near plane, with an invertible covariance; false for anything that is not finite, so that a
// diverged Gaussian disappears instead of spreading.
fn is_valid(g: Geometry) -> bool {
    return !g.has_nan_parameter && g.t.z > view.near && g.det > 0.0 && is_finite(g.det) && is_finite(g.t.z);
}

fn mean_px(g: Geometry) -> vec2<f32> {
    return vec2(view.focal_x, view.focal_y) * g.ratio + vec2(view.axis_x, view.axis_y);
}

// 3DGS's rule: the square of ceil(3 sqrt(lambda_max)) px around the mean meets at least one tile.
fn is_seen(g: Geometry) -> bool {
    if !is_valid(g) {
        return false;
    }
    let middle = 0.5 * (g.cov.x + g.cov.z);
    let largest = middle + sqrt(max(middle * middle - g.det, DISCRIMINANT_MIN));
    let radius = ceil(3.0 * sqrt(largest));
    let mean = mean_px(g);
    let grid = vec2(f32(view.tiles_x), f32(view.tiles_y));
    let side = f32(TILE);
    let first = clamp(trunc((mean - radius) / side), vec2(0.0), grid);
    let end = clamp(trunc((mean + radius + (side - 1.0)) / side), vec2(0.0), grid);
    return all(end > first);
}

// True where the splat reaches the image; then `out` is the splat without its colour.
fn splat_of(g: Geometry, out: ptr<function, Splat>) -> bool {
    // By bits wherever a NaN must not pass: fast maths may turn a comparison around, and then NaNs pass.
    if !is_valid(g) || !is_finite(g.opacity_effective) || g.opacity_effective <= ALPHA_MIN {
        return false;
    }
    let mean = mean_px(g);
    // alpha >= 1/255 <=> d^T cov^-1 d <= 2 ln(255 o): half extents sqrt(2 ln(255 o) cov_kk).
    let log2_opacity = log2(g.opacity_effective);
    // At alpha = 1/255 the logarithm's rounding may leave it below 0, and the root would be NaN.
    let reach = max(2.0 * LN_2 * (log2_opacity + LOG2_255), 0.0);
    let half_extent_px = sqrt(reach * g.cov.xz);
    let size = vec2(f32(view.width), f32(view.height));
    let is_known = is_finite(mean.x) && is_finite(mean.y) && !has_nan(vec4(half_extent_px, 0.0, 0.0));
    if !is_known || any(mean + half_extent_px < vec2(0.0)) || any(mean - half_extent_px > size - 1.0) {
        return false;
    }
    let scale = LOG2_E / g.det;
    (*out).mean_px = mean;
    (*out).log2_opacity = log2_opacity;
    (*out).half_extent_px = half_extent_px;
    (*out).conic_log2 = vec3(-0.5 * scale * g.cov.z, scale * g.cov.y, -0.5 * scale * g.cov.x);
    return true;
}
