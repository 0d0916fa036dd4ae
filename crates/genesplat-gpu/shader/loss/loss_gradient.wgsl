// Stage `loss`, step 3: dL/dimage. SSIM's part is blur(dS/dE[x]) + 2 x blur(dS/dE[x^2]) + y blur(dS/dE[xy]): the window
// is symmetric.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
// By the mean, by the mean square, by the mean product [3, H, W]
@group(0) @binding(3) var<storage, read> by_mean: array<f32>;
@group(0) @binding(4) var<storage, read> by_square: array<f32>;
@group(0) @binding(5) var<storage, read> by_product: array<f32>;
// [3, H, W]
@group(0) @binding(6) var<storage, read_write> gradient: array<f32>;

var<workgroup> halo: array<vec3<f32>, HALO * HALO>;
var<workgroup> blurred: array<vec3<f32>, HALO * TILE>;

@compute @workgroup_size(TILE, TILE)
fn main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixels = view.width * view.height;
    let channel = tile.z;
    // 1. The tile with its margins.
    for (var first = 0u; first < HALO * HALO; first += TILE_PIXELS) {
        let at = first + lane;
        if at < HALO * HALO {
            let x = i32(tile.x * TILE + at % HALO) - i32(SSIM_RADIUS);
            let y = i32(tile.y * TILE + at / HALO) - i32(SSIM_RADIUS);
            halo[at] = vec3(0.0);
            if x >= 0 && y >= 0 && x < i32(view.width) && y < i32(view.height) {
                let index = channel * pixels + u32(y) * view.width + u32(x);
                halo[at] = vec3(by_mean[index], by_square[index], by_product[index]);
            }
        }
    }
    workgroupBarrier();
    // 2. Blur along rows, then columns.
    for (var first = 0u; first < HALO * TILE; first += TILE_PIXELS) {
        let at = first + lane;
        if at < HALO * TILE {
            let left = at / TILE * HALO + at % TILE;
            var sum = vec3(0.0);
            for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
                sum += SSIM_WINDOW[tap] * halo[left + tap];
            }
            blurred[at] = sum;
        }
    }
    workgroupBarrier();
    var by = vec3(0.0);
    for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
        by += SSIM_WINDOW[tap] * blurred[(local.y + tap) * TILE + local.x];
    }
    // 3. Both terms of the loss; the subgradient of |x| at 0 is 0.
    let pixel = tile.xy * TILE + local.xy;
    if pixel.x < view.width && pixel.y < view.height {
        let index = pixel.y * view.width + pixel.x;
        let x = image[channel * pixels + index];
        let y = photo_value(photo[index], channel);
        let values = f32(3u * pixels);
        let structure = by.x + 2.0 * x * by.y + y * by.z;
        let total = ((1.0 - LAMBDA_DSSIM) * sign(x - y) - LAMBDA_DSSIM * structure) / values;
        gradient[channel * pixels + index] = select(0.0, total, counts(photo[index]));
    }
}
