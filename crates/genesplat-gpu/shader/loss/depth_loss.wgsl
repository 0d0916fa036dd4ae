// Stage `loss` of a picture of inverse depth: the absolute difference of one tile from the depths that are
// known, and the gradient by it.

@group(0) @binding(0) var<uniform> view: ViewPass;
// [3, H, W]; red is inverse depth
@group(0) @binding(1) var<storage, read> image: array<f32>;
// 16-bit codes [H, W]; 0 where the depth is not known
@group(0) @binding(2) var<storage, read> codes: array<u32>;
// As `loss` leaves them, of which the step's loss is made [channels, tiles]
@group(0) @binding(3) var<storage, read_write> sums: array<vec4<f32>>;
// [3, H, W]
@group(0) @binding(4) var<storage, read_write> gradient: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(5) var<uniform> first_tile_row: u32;

// Difference and number of pixels.
var<workgroup> parts: array<vec2<f32>, GROUP>;

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group.xy + vec2(0u, first_tile_row);
    let pixels = view.width * view.height;
    let weight = view.background.w;
    // 1. One pixel.
    let pixel = tile * TILE + vec2(lane % TILE, lane / TILE);
    var part = vec2(0.0);
    if pixel.x < view.width && pixel.y < view.height {
        let at = pixel.y * view.width + pixel.x;
        let code = codes[at] & 0xffffu;
        let difference = image[at] - f32(code) * (1.0 / 65535.0);
        part = vec2(select(abs(difference), 0.0, code == 0u), 1.0);
        gradient[at] = select(sign(difference) * weight / f32(pixels), 0.0, code == 0u);
        gradient[pixels + at] = 0.0;
        gradient[2u * pixels + at] = 0.0;
    }
    // 2. Sums of the tile, in a fixed order. The step's loss is 0.8 times a mean over three channels, and 0.2
    //    of what SSIM lacks to 1.
    parts[lane] = part;
    for (var half = GROUP / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            parts[lane] += parts[lane + half];
        }
    }
    if lane == 0u {
        let sum = parts[0];
        let tiles = view.tiles_x * view.tiles_y;
        let first = tile.y * view.tiles_x + tile.x;
        sums[first] = vec4(3.0 * weight / (1.0 - LAMBDA_DSSIM) * sum.x, sum.y, 0.0, 0.0);
        sums[tiles + first] = vec4(0.0, sum.y, 0.0, 0.0);
        sums[2u * tiles + first] = vec4(0.0, sum.y, 0.0, 0.0);
    }
}
