// Spherical harmonics of one Gaussian seen from one camera. Coefficients are outermost, so that a group of
// four coefficients of three channels is three vectors.

// Groups of four coefficients, and those that hold the active ones.
const SH_GROUPS: u32 = 4u;

fn sh_groups(degree: u32) -> u32 {
    return ((degree + 1u) * (degree + 1u) + 3u) / 4u;
}

// The four basis functions of one of these groups at a unit direction; 0 above the degree. A vector of known
// places: an array of all sixteen would lie in memory.
fn sh_basis(degree: u32, group: u32, d: vec3<f32>) -> vec4<f32> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    switch group {
        case 0u: {
            return vec4(SH_C0, select(vec3(0.0), SH_C1 * vec3(-y, z, -x), degree >= 1u));
        }
        case 1u: {
            return vec4(SH_C2[0] * x * y, SH_C2[1] * y * z, SH_C2[2] * (2.0 * zz - xx - yy), SH_C2[3] * x * z);
        }
        case 2u: {
            let third = vec3(SH_C3[0] * y * (3.0 * xx - yy), SH_C3[1] * x * y * z, SH_C3[2] * y * (4.0 * zz - xx - yy));
            return vec4(SH_C2[4] * (xx - yy), select(vec3(0.0), third, degree >= 3u));
        }
        default: {
            return vec4(
                SH_C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), SH_C3[4] * x * (4.0 * zz - xx - yy),
                SH_C3[5] * z * (xx - yy), SH_C3[6] * x * (xx - 3.0 * yy));
        }
    }
}

// Direction from the camera to the Gaussian, and 1 / distance.
fn view_direction(position: vec3<f32>) -> vec4<f32> {
    let d = position - view.centre.xyz;
    let inverse = 1.0 / max(sqrt(dot(d, d)), 1e-12);
    return vec4(d * inverse, inverse);
}
