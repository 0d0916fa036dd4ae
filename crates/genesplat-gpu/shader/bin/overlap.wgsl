// Which tiles a splat reaches: the one function that counting and emitting share.
//
// Exact and opacity-aware: a splat is listed where its ellipse alpha >= 1/255 meets the pixel centres of a
// 4x4-pixel block of the tile. The ellipse is convex, so within a band of four pixel rows it covers one
// interval of columns; the four bands of a tile row are solved at once.

// Block columns [begin, end) that the ellipse covers in each of the four bands of a tile row.
struct Spans {
    begin: vec4<i32>,
    end: vec4<i32>,
}

// Tile rows [x, y) that a splat can reach.
fn tile_rows_of(splat: Splat) -> vec2<u32> {
    let reach = splat.half_extent_px.y + SLACK_PX;
    let limit = f32(view.tiles_y);
    let first = clamp(floor((splat.mean_px.y - reach) / f32(TILE)), 0.0, limit);
    let end = clamp(floor((splat.mean_px.y + reach) / f32(TILE)) + 1.0, 0.0, limit);
    return vec2(u32(first), u32(end));
}

fn boundary(row: vec4<f32>, sign: f32, a: f32, b: f32, det: f32, a_reach: f32) -> vec4<f32> {
    let squared = row * row * -det + a_reach;
    return (sqrt(max(squared, vec4(0.0))) * sign - row * b) / a;
}

fn spans_of(splat: Splat, tile_y: u32) -> Spans {
    // a dx^2 + 2 b dx dy + c dy^2 <= reach, in powers of two of alpha.
    let a = -splat.conic_log2.x;
    let b = -0.5 * splat.conic_log2.y;
    let c = -splat.conic_log2.z;
    let det = a * c - b * b;
    let a_reach = a * (splat.log2_opacity + LOG2_255 + SLACK_LOG2);
    let top = vec4(0.0, 4.0, 8.0, 12.0) + (f32(tile_y * TILE) - splat.mean_px.y);
    let bottom = top + 3.0;
    let height = splat.half_extent_px.y + SLACK_PX;

    // Rows of the band where the right and the left boundary reach furthest: the ellipse's own extreme rows,
    // or the nearest row of the band.
    let extreme = -b * splat.half_extent_px.x / c;
    let low = max(top, vec4(-height));
    let high = min(bottom, vec4(height));
    let right = boundary(min(max(vec4(extreme), low), high), 1.0, a, b, det, a_reach) + (splat.mean_px.x + SLACK_PX);
    let left = boundary(min(max(vec4(-extreme), low), high), -1.0, a, b, det, a_reach) + (splat.mean_px.x - SLACK_PX);

    // Block j covers pixel centres 4 j to 4 j + 3.
    let limit = vec4(f32(view.tiles_x * 4u));
    let begin = clamp(ceil((left - 3.0) * 0.25), vec4(0.0), limit);
    let end = clamp(floor(right * 0.25) + 1.0, vec4(0.0), limit);
    let outside = (top > vec4(height)) | (bottom < vec4(-height));
    return Spans(vec4<i32>(begin), select(vec4<i32>(end), vec4(0), outside));
}

// Tile columns [x, y) between the leftmost and the rightmost block of a row of tiles.
fn tile_columns_of(spans: Spans) -> vec2<i32> {
    let empty = spans.begin >= spans.end;
    let begin = select(spans.begin, vec4(0x7fffffff), empty);
    let end = select(spans.end, vec4(0), empty);
    let first = min(min(begin.x, begin.y), min(begin.z, begin.w));
    let last = max(max(end.x, end.y), max(end.z, end.w));
    return vec2(first / 4, (last + 3) / 4);
}

fn reaches(spans: Spans, tile_x: i32) -> bool {
    return any(max(spans.begin, vec4(4 * tile_x)) < min(spans.end, vec4(4 * tile_x + 4)));
}

fn count_tiles_of_row(splat: Splat, tile_y: u32) -> u32 {
    var count = 0u;
    let spans = spans_of(splat, tile_y);
    let columns = tile_columns_of(spans);
    for (var tile_x = columns.x; tile_x < columns.y; tile_x++) {
        count += u32(reaches(spans, tile_x));
    }
    return count;
}

fn count_tiles(splat: Splat) -> u32 {
    var count = 0u;
    let rows = tile_rows_of(splat);
    for (var tile_y = rows.x; tile_y < rows.y; tile_y++) {
        count += count_tiles_of_row(splat, tile_y);
    }
    return count;
}
