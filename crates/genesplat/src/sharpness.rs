//! How sharp a picture is: the variance of its Laplacian (Pech-Pacheco et al. 2000), which blur takes away.

use genesplat::core::Photo;

/// Variance of the Laplacian of the brightness, over all pixels but the rim; 0 for a picture without an
/// inside.
pub(crate) fn laplacian_variance(photo: &Photo) -> f64 {
    let [width, height] = [photo.width, photo.height].map(|side| side as usize);
    let brightness: Vec<f64> = photo
        .rgb
        .chunks_exact(3)
        .map(|rgb| 0.299 * f64::from(rgb[0]) + 0.587 * f64::from(rgb[1]) + 0.114 * f64::from(rgb[2]))
        .collect();
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for v in 1..height.max(1) - 1 {
        for u in 1..width.max(1) - 1 {
            let at = v * width + u;
            let around =
                brightness[at - 1] + brightness[at + 1] + brightness[at - width] + brightness[at + width];
            let laplacian = around - 4.0 * brightness[at];
            (sum, squares, count) = (sum + laplacian, squares + laplacian * laplacian, count + 1.0);
        }
    }
    if count == 0.0 { 0.0 } else { squares / count - (sum / count).powi(2) }
}

#[cfg(test)]
mod tests {
    use genesplat::io::photos::resize;

    use super::*;

    fn grey(width: u32, height: u32, level: impl Fn(u32, u32) -> u8) -> Photo {
        let rgb = (0..width * height).flat_map(|at| [level(at % width, at / width); 3]).collect();
        Photo { width, height, rgb }
    }

    #[test]
    fn a_blurred_picture_is_less_sharp() {
        let sharp = grey(64, 48, |u, v| if (u / 3 + v / 5) % 2 == 0 { 220 } else { 30 });
        let blurred = resize(&resize(&sharp, 16, 12), 64, 48);
        assert!(laplacian_variance(&sharp) > 3.0 * laplacian_variance(&blurred));
    }

    /// A ramp has no curvature; one bright pixel has a Laplacian of −4 there and 1 at its four neighbours.
    #[test]
    fn known_pictures_have_known_values() {
        assert!(laplacian_variance(&grey(9, 9, |u, v| (7 * u + 3 * v) as u8)) < 1e-9);
        let dot = grey(5, 5, |u, v| if (u, v) == (2, 2) { 100 } else { 0 });
        assert!((laplacian_variance(&dot) - (100.0 * 100.0) * 20.0 / 9.0).abs() < 1e-6);
        assert_eq!(laplacian_variance(&grey(1, 1, |_, _| 9)), 0.0);
    }
}
