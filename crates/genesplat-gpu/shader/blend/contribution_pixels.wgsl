// Stage `contribution`, step 1: in the place of dL/dimage, ones and the errors of all channels together. The backward
// blending then sums blending weights where it sums the gradient of red, and weighted errors where it sums that of
// green.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
// In the place of dL/dimage [3, H, W].
@group(0) @binding(3) var<storage, read_write> gradient: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(4) var<uniform> first_tile_row: u32;

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let pixel = tile.xy * TILE + local.xy;
    if pixel.x >= view.width || pixel.y >= view.height {
        return;
    }
    let pixels = view.width * view.height;
    let index = pixel.y * view.width + pixel.x;
    var error = 0.0;
    for (var channel = 0u; channel < 3u; channel++) {
        error += abs(image[channel * pixels + index] - photo_value(photo[index], channel));
    }
    let is_counted = counts(photo[index]);
    gradient[index] = select(0.0, 1.0, is_counted);
    gradient[pixels + index] = select(0.0, error, is_counted);
    gradient[2u * pixels + index] = 0.0;
}
