// Stage `weigh`, step 1: in the place of dL/dimage, ones and the errors of all channels together. The backward blending then
// sums what Gaussians are worth where it sums the gradient of red, and the error that they have part in where it sums that
// of green.

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let pixel = tile.xy * TILE + local.xy;
    if pixel.x >= frame.width || pixel.y >= frame.height {
        return;
    }
    let pixels = frame.width * frame.height;
    let index = pixel.y * frame.width + pixel.x;
    gradient[index] = 1.0;
    gradient[pixels + index] = error_at(index);
    gradient[2u * pixels + index] = 0.0;
}
