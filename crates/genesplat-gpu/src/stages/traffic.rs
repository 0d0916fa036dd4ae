//! What a stage of a training step has to move through the memory of the device at least.
//!
//! Every value that a stage reads from another, or leaves for one, is counted once; what stays in registers
//! and workgroup memory is not. On a large cloud, a stage that takes as long as this is as fast as the
//! device's memory.

use crate::layout::{
    DENSITY_FLOATS, GEOMETRY_FLOATS, GRADIENT_FLOATS, INTERSECTION_GRADIENT_FLOATS, SPLAT_FLOATS,
};

/// How much there is to do.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// Gaussians.
    pub rows: u64,
    /// Splats of the view.
    pub visible: u64,
    /// Intersections of its splats with tiles.
    pub intersections: u64,
    /// Of the photo.
    pub size_px: [u64; 2],
    /// Of the colours that are seen.
    pub sh_degree: u8,
}

impl Work {
    /// Bytes that a stage moves at least; 0 for one that is not known.
    pub fn bytes(&self, stage: &str) -> u64 {
        let Self { rows, visible, intersections, size_px: [width, height], .. } = *self;
        let [geometry, splat, gradient, intersection_gradient, statistics] =
            [GEOMETRY_FLOATS, SPLAT_FLOATS, GRADIENT_FLOATS, INTERSECTION_GRADIENT_FLOATS, DENSITY_FLOATS]
                .map(|floats| 4 * u64::from(floats));
        let [evaluated, differentiated, moved] = self.colour_bytes();
        let pixels = width * height;
        match stage {
            // Tile counts of all rows; depths of splats, and their first and third vectors once more; which
            // steps their colours have made.
            "project" => rows * (geometry + 4) + visible * (evaluated + splat + 4 + 32 + 8),
            // Tile counts of all rows are read; of splats they themselves and the depth, and their first
            // intersections are written. Of intersections, splat, tile and place are written and read; then
            // depth and number; the number is written in its order.
            "bin" => rows * 4 + visible * (splat + 8) + intersections * (2 * 12 + 2 * 8 + 4),
            // Three channels of f32 are written.
            "rasterise" => intersections * 8 + visible * splat + pixels * 12,
            // Both steps read render and photo; nine partial derivatives pass between them; the gradient is
            // written.
            "loss" => pixels * (2 * (12 + 4) + 2 * 36 + 12),
            // Render and gradient are read.
            "rasterise_backward" => {
                intersections * (8 + intersection_gradient) + visible * splat + pixels * 24
            }
            // Tile counts of all rows; of splats the first intersection and the vector with the flags.
            "project_backward" => {
                intersections * intersection_gradient
                    + visible * (geometry + differentiated + gradient + 4 + 16)
                    + rows * 4
            }
            // Parameters and two moments are read and written: geometry of all rows, colours and density
            // statistics of what is visible, which alone has gradients.
            "update" => rows * (6 * geometry + 4) + visible * (gradient + 6 * moved + 8 + 2 * statistics),
            _ => 0,
        }
    }

    /// Bytes of a row's colours: to evaluate them, to differentiate them, and of those that the optimiser
    /// moves. Above degree 0 they come in groups of four coefficients of three channels.
    fn colour_bytes(&self) -> [u64; 3] {
        match self.sh_degree {
            0 => [12, 0, 16],
            degree => [(u64::from(degree) + 1).pow(2).div_ceil(4) * 48; 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_moves_what_its_columns_hold() {
        let work = Work { rows: 1000, visible: 0, intersections: 0, size_px: [160, 90], sh_degree: 3 };
        // Six columns of 48 bytes and tile counts; of what is seen, gradients, six of 192 and its statistics,
        // too.
        assert_eq!(work.bytes("update"), 1000 * (288 + 4));
        let seen = |sh_degree| Work { visible: 10, sh_degree, ..work }.bytes("update") - work.bytes("update");
        assert_eq!([0, 1, 3].map(seen), [16, 48, 192].map(|moved| 10 * (64 + 6 * moved + 24)));
        assert_eq!(work.bytes("project"), 1000 * (48 + 4));
        assert_eq!(work.bytes("loss"), 160 * 90 * 116);
        assert_eq!(work.bytes("nothing"), 0);
        let listed = Work { visible: 10, intersections: 30, ..work };
        assert_eq!(listed.bytes("bin") - work.bytes("bin"), 10 * 56 + 30 * 44);
    }
}
