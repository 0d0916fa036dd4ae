// A tile with its margins in workgroup memory, which two stages blur: along rows, two pixels an invocation,
// then along columns. Sums of rows come into the place of what they are of, columns first.

// Side of a tile with its margins.
const HALO: u32 = TILE + 2u * SSIM_RADIUS;
// Longer than its side, so that naga's checks of places below 32 can be left out, and odd, so that neither
// rows nor columns ask one memory bank.
const HALO_PITCH: u32 = 33u;
// Rows that are loaded at once, 32 invocations each.
const HALO_STEP: u32 = GROUP / 32u;
// Neighbours that an invocation blurs along a row: that spares half of the reads, and occupies all
// invocations.
const ROW_PIXELS: u32 = 2u;

var<workgroup> halo: array<array<vec4<f32>, HALO_PITCH>, HALO>;

// What an invocation has loaded so many rows below its own, which is `lane / 32`; columns beyond the halo are
// never read.
fn leave(lane: u32, down: u32, value: vec4<f32>) {
    if down + HALO_STEP <= HALO || lane / 32u + down < HALO {
        halo[lane / 32u % HALO_STEP + down][lane % 32u] = value;
    }
}

// The first of the pixels that an invocation blurs along a row, and that row of the halo.
fn blurred_row(lane: u32) -> vec2<u32> {
    return vec2(lane / 32u % (TILE / ROW_PIXELS) * ROW_PIXELS, lane % 32u);
}

fn is_blurred(row: vec2<u32>) -> bool {
    return row.y < HALO;
}

// The pixel of an invocation: neighbours along rows.
fn pixel_in_rows(lane: u32) -> vec2<u32> {
    return vec2(lane % TILE, lane / TILE % TILE);
}
