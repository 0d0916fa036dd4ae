// Stage `loss`, step 3: dL/dimage. SSIM's part is blur(dS/dE[x]) + 2 x blur(dS/dE[x^2]) + y blur(dS/dE[xy]):
// the window is symmetric.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
// By the mean, by the mean square, by the mean product [3, H, W]
@group(0) @binding(3) var<storage, read> by_mean: array<f32>;
@group(0) @binding(4) var<storage, read> by_square: array<f32>;
@group(0) @binding(5) var<storage, read> by_product: array<f32>;
// [3, H, W]
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(7) var<uniform> first_tile_row: u32;

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let pixels = view.width * view.height;
    let channel = tile.z;
    // 1. The tile with its margins.
    let column = lane % 32u;
    let corner = tile.xy * TILE + vec2(column, lane / 32u) - SSIM_RADIUS;
    // Left of the image, and above it, numbers wrap.
    let is_inside = column < HALO && corner.x < view.width;
    let first = channel * pixels + corner.y * view.width + corner.x;
    for (var down = 0u; down < HALO; down += HALO_STEP) {
        var partials = vec4(0.0);
        if is_inside && corner.y + down < view.height {
            let index = first + down * view.width;
            partials = vec4(by_mean[index], by_square[index], by_product[index], 0.0);
        }
        leave(lane, down, partials);
    }
    workgroupBarrier();
    // 2. Blur along rows, then columns.
    let row = blurred_row(lane);
    var sums_of_row: array<vec3<f32>, ROW_PIXELS>;
    if is_blurred(row) {
        var values: array<vec3<f32>, ROW_PIXELS + 2u * SSIM_RADIUS>;
        for (var x = 0u; x < ROW_PIXELS + 2u * SSIM_RADIUS; x++) {
            values[x] = halo[row.y][row.x + x].xyz;
        }
        for (var pixel = 0u; pixel < ROW_PIXELS; pixel++) {
            for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
                sums_of_row[pixel] += SSIM_WINDOW[tap] * values[pixel + tap];
            }
        }
    }
    workgroupBarrier();
    if is_blurred(row) {
        for (var pixel = 0u; pixel < ROW_PIXELS; pixel++) {
            halo[row.x + pixel][row.y] = vec4(sums_of_row[pixel], 0.0);
        }
    }
    workgroupBarrier();
    let local = pixel_in_rows(lane);
    var by = vec3(0.0);
    for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
        by += SSIM_WINDOW[tap] * halo[local.x][local.y + tap].xyz;
    }
    // 3. Both terms of the loss.
    let pixel = tile.xy * TILE + local;
    if pixel.x < view.width && pixel.y < view.height {
        let index = pixel.y * view.width + pixel.x;
        let x = image[channel * pixels + index];
        let y = photo_value(photo[index], channel);
        let values = f32(3u * pixels);
        let structure = by.x + 2.0 * x * by.y + y * by.z;
        // The subgradient of |x| at 0 is 0.
        let total = ((1.0 - LAMBDA_DSSIM) * sign(x - y) - LAMBDA_DSSIM * structure) / values;
        gradient[channel * pixels + index] = select(0.0, total, counts(photo[index]));
    }
}
