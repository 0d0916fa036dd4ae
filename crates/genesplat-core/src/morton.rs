//! The order of points along a Morton curve (Z-order): what is near on the curve is near in space.

/// Cells of the curve along the widest axis.
const CELLS: f32 = ((1 << 21) - 1) as f32;

/// Indices of `positions` along a Morton curve through their bounding box; ties stay in the order given.
pub fn morton_order(positions: &[[f32; 3]]) -> Vec<u32> {
    let finite = |axis: usize| positions.iter().map(move |position| position[axis]).filter(|v| v.is_finite());
    let low: [f32; 3] = std::array::from_fn(|axis| finite(axis).fold(f32::INFINITY, f32::min));
    let high: [f32; 3] = std::array::from_fn(|axis| finite(axis).fold(f32::NEG_INFINITY, f32::max));
    let widest = (0..3).map(|axis| high[axis] - low[axis]).fold(f32::MIN_POSITIVE, f32::max);
    let cell = |value: f32, axis: usize| ((value - low[axis]) / widest * CELLS) as u64;
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_by_cached_key(|&index| {
        let position = positions[index as usize];
        (0..3).map(|axis| spread_bits(cell(position[axis], axis)) << axis).fold(0, |code, bits| code | bits)
    });
    order
}

/// Moves bit `k` to bit `3k`, for 21 bits.
fn spread_bits(value: u64) -> u64 {
    (0..21).fold(0, |spread, bit| spread | (value >> bit & 1) << (3 * bit))
}
