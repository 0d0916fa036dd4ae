// Stage `loss`, step 1: L1 and SSIM of one tile of one channel, and SSIM's partial derivatives by its
// moments.
//
// The 11x11 window is separable: moments are blurred along rows, then along columns. Outside of the image
// everything is zero, as published.

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
// Of those that this dispatch has.
@group(0) @binding(7) var<uniform> first_tile_row: u32;


@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let pixels = view.width * view.height;
    let plane = tile.z;
    let channel = plane % 3u;
    // 1. Moments of the tile with its margins.
    let column = lane % 32u;
    let corner = tile.xy * TILE + vec2(column, lane / 32u) - SSIM_RADIUS;
    // Left of the image, and above it, numbers wrap.
    let is_inside = column < HALO && corner.x < view.width;
    let first = corner.y * view.width + corner.x;
    for (var down = 0u; down < HALO; down += HALO_STEP) {
        var moments = vec4(0.0);
        if is_inside && corner.y + down < view.height {
            let index = first + down * view.width;
            let rgb = photo[index];
            // Where nothing counts, both are zero.
            let is_counted = counts(rgb);
            let x = select(0.0, image[plane * pixels + index], is_counted);
            let y = select(0.0, photo_value(rgb, channel), is_counted);
            moments = vec4(x, y, x * x + y * y, x * y);
        }
        leave(lane, down, moments);
    }
    workgroupBarrier();
    let local = pixel_in_rows(lane);
    let own = halo[local.y + SSIM_RADIUS][local.x + SSIM_RADIUS];
    let difference = abs(own.x - own.y);
    // 2. Their blur along rows.
    let row = blurred_row(lane);
    var sums_of_row: array<vec4<f32>, ROW_PIXELS>;
    if is_blurred(row) {
        var values: array<vec4<f32>, ROW_PIXELS + 2u * SSIM_RADIUS>;
        for (var x = 0u; x < ROW_PIXELS + 2u * SSIM_RADIUS; x++) {
            values[x] = halo[row.y][row.x + x];
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
            halo[row.x + pixel][row.y] = sums_of_row[pixel];
        }
    }
    workgroupBarrier();
    // 3. Along columns, and the loss of this pixel.
    var moments = vec4(0.0);
    for (var tap = 0u; tap < 2u * SSIM_RADIUS + 1u; tap++) {
        moments += SSIM_WINDOW[tap] * halo[local.x][local.y + tap];
    }
    let pixel = tile.xy * TILE + local;
    let inside = pixel.x < view.width && pixel.y < view.height;
    var value = vec3(0.0);
    if inside {
        let ssim = ssim_of(moments);
        value = vec3(difference, ssim.value, difference * difference);
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
        sums[(plane * view.tiles_y + tile.y) * view.tiles_x + tile.x] = vec4(total, 0.0);
    }
}

// The sum over the workgroup, for invocation 0; `halo` is free by now.
fn sum_of_tile(lane: u32, value: vec3<f32>) -> vec3<f32> {
    var sum = value;
    for (var count = TILE_PIXELS / 4u; count > 0u; count /= 4u) {
        // Those that had a sum leave it, and a quarter of them sum four.
        if lane < 4u * count {
            halo[lane / 32u % 8u][lane % 32u] = vec4(sum, 0.0);
        }
        workgroupBarrier();
        sum = vec3(0.0);
        if lane < count {
            for (var part = 0u; part < 4u; part++) {
                let at = lane % count + part * count;
                sum += halo[at / 32u][at % 32u].xyz;
            }
        }
        // No barrier: what an invocation leaves next, it alone has read.
    }
    return sum;
}
