// Reads the coefficients of one row of `sh`: array<vec4<f32>>, 12 vectors a row.

// Four coefficients, from coefficient 4 * group on: columns are their colours.
fn sh_group(row: u32, group: u32) -> array<vec3<f32>, 4> {
    let at = 12u * row + 3u * group;
    let a = sh[at];
    let b = sh[at + 1u];
    let c = sh[at + 2u];
    return array(a.xyz, vec3(a.w, b.xy), vec3(b.zw, c.x), c.yzw);
}

// Colour before 0.5 is added and it is clamped.
fn sh_colour(row: u32, degree: u32, position: vec3<f32>) -> vec3<f32> {
    if degree == 0u {
        return SH_C0 * sh[12u * row].xyz;
    }
    let direction = view_direction(position).xyz;
    var sum = vec3(0.0);
    for (var group = 0u; group < SH_GROUPS; group++) {
        if group < sh_groups(degree) {
            let basis = sh_basis(degree, group, direction);
            let rgb = sh_group(row, group);
            for (var k = 0u; k < 4u; k++) {
                sum += basis[k] * rgb[k];
            }
        }
    }
    return sum;
}
