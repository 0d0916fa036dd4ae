//! Gradients of several views for one optimiser step: kept view by view, and taken with those of the last
//! one.

use super::chunk::{ChunkGradients, RowsMut};

/// Adds the gradients of a view to those that wait; rows without a splat have none.
pub(crate) fn keep_pending(gradients: &ChunkGradients, pending: &mut RowsMut) {
    for &row in &gradients.touched {
        let row = row as usize;
        let [x, y, z, sx, sy, sz, opacity] = gradients.genes[row];
        add(&mut pending.positions[row], &[x, y, z]);
        add(&mut pending.log_scales[row], &[sx, sy, sz]);
        pending.opacity_logits[row] += opacity;
        add(&mut pending.rotations[row], &gradients.rotations[row]);
        add(&mut pending.sh[row], &gradients.sh[row]);
    }
}

/// Adds what waits to the gradients of a view, and leaves zeros.
pub(crate) fn take_pending(gradients: &mut ChunkGradients, pending: &mut RowsMut) {
    for row in 0..pending.positions.len() {
        let ([x, y, z], [sx, sy, sz]) =
            (take(&mut pending.positions[row]), take(&mut pending.log_scales[row]));
        let [opacity] = take(std::array::from_mut(&mut pending.opacity_logits[row]));
        add(&mut gradients.genes[row], &[x, y, z, sx, sy, sz, opacity]);
        add(&mut gradients.rotations[row], &take(&mut pending.rotations[row]));
        add(&mut gradients.sh[row], &take(&mut pending.sh[row]));
    }
    if !pending.positions.is_empty() {
        // Any row has gradients now, which the next view must not find.
        gradients.touched.clear();
        gradients.touched.extend(0..pending.positions.len() as u32);
    }
}

fn add<const K: usize>(sums: &mut [f32; K], values: &[f32; K]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}

fn take<const K: usize>(sums: &mut [f32; K]) -> [f32; K] {
    std::mem::replace(sums, [0.0; K])
}
