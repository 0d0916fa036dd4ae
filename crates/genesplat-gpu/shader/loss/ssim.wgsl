// SSIM at one pixel, from raw moments E[x], E[y], E[x^2 + y^2], E[xy] (x the render, y the photo).
//
// S = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sx^2 + sy^2 + C2)), variances as E[x^2] - m^2; the two
// variances only enter as their sum.

struct Ssim {
    value: f32,
    // By E[x], E[x^2], E[xy].
    partials: vec3<f32>,
}

fn ssim_of(moments: vec4<f32>) -> Ssim {
    let mx = moments.x;
    let my = moments.y;
    let mxx_myy = mx * mx + my * my;
    let mxy = mx * my;
    let n0 = 2.0 * mxy + SSIM_C1;
    let n1 = 2.0 * (moments.w - mxy) + SSIM_C2;
    let d0 = mxx_myy + SSIM_C1;
    let d1 = (moments.z - mxx_myy) + SSIM_C2;
    let inverse = 1.0 / (d0 * d1);
    let value = n0 * n1 * inverse;
    let by_variance = -value / d1;
    let by_covariance = 2.0 * n0 * inverse;
    let direct = 2.0 * (my * n1 * inverse - mx * value / d0);
    return Ssim(value, vec3(direct - 2.0 * mx * by_variance - my * by_covariance, by_variance, by_covariance));
}
