// Stage `loss`, step 1: L1 and SSIM of one tile of one channel, and SSIM's partial derivatives by its moments.
//
// The 11x11 window is separable: rows are blurred into workgroup memory, then columns. Outside of the image everything
// is zero, as published.

// Leave the partial derivatives out: scoring needs the loss only.
override FORWARD_ONLY: bool;
@group(0) @binding(0) var<uniform> view: ViewPass;
// [layers, 3, H, W]; a workgroup takes one plane
@group(0) @binding(1) var<storage, read> image: array<f32>;
// 8-bit RGB a word [H, W]
@group(0) @binding(2) var<storage, read> photo: array<u32>;
// By the mean, by the mean square, by the mean product [3, H, W]
@group(0) @binding(3) var<storage, read_write> by_mean: array<f32>;
@group(0) @binding(4) var<storage, read_write> by_square: array<f32>;
@group(0) @binding(5) var<storage, read_write> by_product: array<f32>;
// Sums of |x - y|, of SSIM and of (x - y)^2 [layers, channels, tiles]
@group(0) @binding(6) var<storage, read_write> sums: array<vec4<f32>>;

var<workgroup> x_halo: array<f32, HALO * HALO>;
var<workgroup> y_halo: array<f32, HALO * HALO>;
var<workgroup> blurred: array<vec4<f32>, HALO * TILE>;

@compute @workgroup_size(TILE, TILE)
fn main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pixels = view.width * view.height;
    let plane = tile.z;
    let channel = plane % 3u;
    // 1. The tile with its margins.
    for (var first = 0u; first < HALO * HALO; first += TILE_PIXELS) {
        let at = first + lane;
        if at < HALO * HALO {
            let x = i32(tile.x * TILE + at % HALO) - i32(SSIM_RADIUS);
            let y = i32(tile.y * TILE + at / HALO) - i32(SSIM_RADIUS);
            x_halo[at] = 0.0;
            y_halo[at] = 0.0;
            if x >= 0 && y >= 0 && x < i32(view.width) && y < i32(view.height) {
                let index = u32(y) * view.width + u32(x);
                // Where nothing counts, both are zero.
                if counts(photo[index]) {
                    x_halo[at] = image[plane * pixels + index];
                    y_halo[at] = photo_value(photo[index], channel);
                }
            }
        }
    }
    workgroupBarrier();
    // 2. Blur of the moments along rows.
    for (var first = 0u; first < HALO * TILE; first += TILE_PIXELS) {
        let at = first + lane;
        if at < HALO * TILE {
            let left = at / TILE * HALO + at % TILE;
            var sum = vec4(0.0);
            for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
                let x = x_halo[left + tap];
                let y = y_halo[left + tap];
                sum += SSIM_WINDOW[tap] * vec4(x, y, x * x + y * y, x * y);
            }
            blurred[at] = sum;
        }
    }
    workgroupBarrier();
    // 3. Along columns, and the loss of this pixel.
    var moments = vec4(0.0);
    for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
        moments += SSIM_WINDOW[tap] * blurred[(local.y + tap) * TILE + local.x];
    }
    let centre = (local.y + SSIM_RADIUS) * HALO + local.x + SSIM_RADIUS;
    let difference = abs(x_halo[centre] - y_halo[centre]);
    let pixel = tile.xy * TILE + local.xy;
    let inside = pixel.x < view.width && pixel.y < view.height;
    var value = vec4(0.0);
    if inside {
        let ssim = ssim_of(moments);
        value = vec4(difference, ssim.value, difference * difference, 0.0);
        if !FORWARD_ONLY {
            let at = channel * pixels + pixel.y * view.width + pixel.x;
            by_mean[at] = ssim.partials.x;
            by_square[at] = ssim.partials.y;
            by_product[at] = ssim.partials.z;
        }
    }
    // 4. Sums of the tile, in a fixed order.
    workgroupBarrier();
    let total = sum_of_tile(lane, value);
    if lane == 0u {
        sums[(plane * view.tiles_y + tile.y) * view.tiles_x + tile.x] = total;
    }
}

// The sum over the workgroup, for invocation 0; `blurred` is free by now.
fn sum_of_tile(lane: u32, value: vec4<f32>) -> vec4<f32> {
    blurred[lane] = value;
    workgroupBarrier();
    if lane < TILE {
        var sum = vec4(0.0);
        for (var i = 0u; i < TILE; i++) {
            sum += blurred[lane + TILE * i];
        }
        blurred[lane] = sum;
    }
    workgroupBarrier();
    var total = vec4(0.0);
    if lane == 0u {
        for (var i = 0u; i < TILE; i++) {
            total += blurred[i];
        }
    }
    return total;
}
