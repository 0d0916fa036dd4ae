// Rotation matrix of a quaternion (w, x, y, z), which is normalised first; columns are the own axes.

fn unit_rotation(rotation: vec4<f32>) -> mat3x3<f32> {
    return rotation_matrix(rotation / max(sqrt(dot(rotation, rotation)), 1e-12));
}

fn rotation_matrix(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x; let x = q.y; let y = q.z; let z = q.w;
    return mat3x3(
        vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}
