// What stages `loss` and `score` have in common: the sum of all tiles of a picture. Needs `view`, and `sums`:
// array<vec4<f32>>, one a tile and channel.

var<workgroup> totals: array<vec4<f32>, GROUP>;

fn sum_at(first: u32, at: u32, count: u32) -> vec4<f32> {
    if at < count {
        return sums[first + at];
    }
    return vec4(0.0);
}

// The mean over the pixels and channels of one layer, for invocation 0. Four sums an invocation, so that no
// addition waits for the one before it, then a tree: always in the same order.
fn mean_of_layer(layer: u32, lane: u32) -> vec4<f32> {
    let count = 3u * view.tiles_x * view.tiles_y;
    let first = layer * count;
    var a = vec4(0.0);
    var b = vec4(0.0);
    var c = vec4(0.0);
    var d = vec4(0.0);
    for (var at = lane; at < count; at += 4u * GROUP) {
        a += sum_at(first, at, count);
        b += sum_at(first, at + GROUP, count);
        c += sum_at(first, at + 2u * GROUP, count);
        d += sum_at(first, at + 3u * GROUP, count);
    }
    totals[lane] = (a + b) + (c + d);
    for (var half = GROUP / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            totals[lane] += totals[lane + half];
        }
    }
    return totals[lane] / f32(3u * view.width * view.height);
}

// Eq. 5, from the means of |x - y| and of SSIM.
fn loss_of(mean: vec4<f32>) -> f32 {
    return (1.0 - LAMBDA_DSSIM) * mean.x + LAMBDA_DSSIM * (1.0 - mean.y);
}
