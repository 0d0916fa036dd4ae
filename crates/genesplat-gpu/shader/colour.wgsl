// Spherical harmonics of one Gaussian seen from one camera. Needs `sh`: array<vec4<f32>>, 12 vectors a row, coefficients
// outermost, so that four coefficients of three channels are three vectors.

// The first (degree + 1)^2 basis functions at a unit direction; 0 above.
fn sh_basis(degree: u32, d: vec3<f32>) -> array<f32, 16> {
    var b = array<f32, 16>();
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    b[0] = SH_C0;
    if degree >= 1u {
        b[1] = -SH_C1 * y;
        b[2] = SH_C1 * z;
        b[3] = -SH_C1 * x;
    }
    if degree >= 2u {
        b[4] = SH_C2[0] * x * y;
        b[5] = SH_C2[1] * y * z;
        b[6] = SH_C2[2] * (2.0 * zz - xx - yy);
        b[7] = SH_C2[3] * x * z;
        b[8] = SH_C2[4] * (xx - yy);
    }
    if degree >= 3u {
        b[9] = SH_C3[0] * y * (3.0 * xx - yy);
        b[10] = SH_C3[1] * x * y * z;
        b[11] = SH_C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = SH_C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = SH_C3[4] * x * (4.0 * zz - xx - yy);
        b[14] = SH_C3[5] * z * (xx - yy);
        b[15] = SH_C3[6] * x * (xx - 3.0 * yy);
    }
    return b;
}

// Direction from the camera to the Gaussian, and 1 / distance.
fn view_direction(position: vec3<f32>) -> vec4<f32> {
    let d = position - frame.centre.xyz;
    let inverse = 1.0 / max(sqrt(dot(d, d)), 1e-12);
    return vec4(d * inverse, inverse);
}
