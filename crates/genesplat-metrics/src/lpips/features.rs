//! What a network does to a picture: convolve, rectify, pool.
//!
//! A convolution is a matrix product: the neighbourhoods of a strip's pixels are copied side by side
//! (`im2col`) and multiplied with the kernel. Strips have a fixed number of pixels and run in parallel: what
//! is copied stays below about 10 MB a thread, and results do not depend on the number of threads.

use genesplat_core::Photo;
use ndarray::linalg::general_mat_mul;
use ndarray::{Array2, ArrayView2, ArrayViewMut2};
use rayon::prelude::*;

use super::InputRange;
use super::network::{POOL_STRIDE, Shape, places};
use crate::weights::NamedTensors;

/// Mean of the training pictures' colours and their spread, as the authors of LPIPS scale `[-1, 1]`.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Least pixels of a strip (it has whole rows): enough to be worth reading a kernel of 9 MB for.
const STRIP_PIXELS: usize = 256;

/// Features of a picture, `[H, W, C]`.
#[derive(Clone, Debug)]
pub(super) struct Features {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) channels: usize,
    pub(super) values: Vec<f32>,
}

impl Features {
    /// The picture as a network's input.
    pub(super) fn of_photo(photo: &Photo, range: InputRange) -> Self {
        let level = |value: u8| match range {
            InputRange::ZeroToOne => f32::from(value) / 255.0,
            InputRange::MinusOneToOne => f32::from(value) / 127.5 - 1.0,
        };
        // Three channels and as many shifts: the colours of a pixel follow each other.
        let scaled = |(at, &value): (usize, &u8)| (level(value) - SHIFT[at % 3]) / SCALE[at % 3];
        let values = photo.rgb.iter().enumerate().map(scaled).collect();
        Self { width: photo.width as usize, height: photo.height as usize, channels: 3, values }
    }

    /// The largest value of each window, channel by channel.
    ///
    /// # Panics
    /// When the window does not fit.
    pub(super) fn max_pool(&self, window: usize) -> Self {
        let side = |side| places(side, window, POOL_STRIDE, 0).expect("the window fits");
        let (width, height, channels) = (side(self.width), side(self.height), self.channels);
        let mut values = vec![f32::NEG_INFINITY; width * height * channels];
        values.par_chunks_mut(width * channels).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                for source_y in POOL_STRIDE * y..POOL_STRIDE * y + window {
                    let first = channels * (source_y * self.width + POOL_STRIDE * x);
                    for source in self.values[first..first + channels * window].chunks_exact(channels) {
                        pixel.iter_mut().zip(source).for_each(|(most, &value)| *most = most.max(value));
                    }
                }
            }
        });
        Self { width, height, channels, values }
    }
}

/// A convolution with its rectifier.
#[derive(Debug)]
pub(super) struct Convolution {
    shape: Shape,
    /// `[kernel row, kernel column, input; output]`: the order of a copied neighbourhood.
    kernel: Array2<f32>,
    bias: Vec<f32>,
}

impl Convolution {
    /// Takes its kernel and bias, whose shapes were checked, from `tensors`.
    pub(super) fn new(shape: Shape, tensors: &NamedTensors) -> Self {
        let Shape { inputs, outputs, kernel: side, .. } = shape;
        let [weight, bias] = shape.names().map(|name| &tensors[&name].values);
        // From [output, input, row, column].
        let value = |(at, output): (usize, usize)| {
            let (place, input) = (at / inputs, at % inputs);
            weight[(output * inputs + input) * side * side + place]
        };
        let kernel = Array2::from_shape_fn((side * side * inputs, outputs), value);
        Self { shape, kernel, bias: bias.clone() }
    }

    /// `max(0, kernel * input + bias)`.
    ///
    /// # Panics
    /// When the kernel does not fit, or the channels differ.
    pub(super) fn apply(&self, input: &Features) -> Features {
        let Shape { inputs, outputs, .. } = self.shape;
        assert_eq!(input.channels, inputs, "layers follow each other");
        let side = |side| self.shape.output_side(side).expect("the kernel fits");
        let (width, height) = (side(input.width), side(input.height));
        let rows = STRIP_PIXELS.div_ceil(width);
        let mut values = vec![0.0; width * height * outputs];
        values.par_chunks_mut(rows * width * outputs).enumerate().for_each_init(
            Vec::new,
            |columns, (strip, out)| {
                self.neighbourhoods(input, strip * rows, width, out.len() / (width * outputs), columns);
                self.multiply(columns, out);
            },
        );
        Features { width, height, channels: outputs, values }
    }

    /// Copies what `rows` output rows from `first` on see: `[pixel; kernel row, kernel column, input]`, zero
    /// outside.
    fn neighbourhoods(
        &self,
        input: &Features,
        first: usize,
        width: usize,
        rows: usize,
        columns: &mut Vec<f32>,
    ) {
        let Shape { inputs, kernel: side, stride, padding, .. } = self.shape;
        columns.clear();
        columns.resize(rows * width * side * side * inputs, 0.0);
        for (place, run) in columns.chunks_exact_mut(side * inputs).enumerate() {
            let (pixel, kernel_row) = (place / side, place % side);
            // Below zero it wraps to a huge number, which is as much outside as one beyond the last row.
            let y = ((first + pixel / width) * stride + kernel_row).wrapping_sub(padding);
            if y >= input.height {
                continue;
            }
            // The columns of the padded picture that this run covers, and the part of them that is picture.
            let left = (pixel % width) * stride;
            let (from, to) = (left.max(padding), (left + side).min(input.width + padding));
            if from < to {
                let at = (y * input.width + from - padding) * inputs;
                let length = (to - from) * inputs;
                run[(from - left) * inputs..][..length].copy_from_slice(&input.values[at..at + length]);
            }
        }
    }

    fn multiply(&self, columns: &[f32], out: &mut [f32]) {
        let (taps, outputs) = self.kernel.dim();
        let pixels = columns.len() / taps;
        out.chunks_exact_mut(outputs).for_each(|pixel| pixel.copy_from_slice(&self.bias));
        let columns = ArrayView2::from_shape((pixels, taps), columns).expect("whole neighbourhoods");
        let mut product = ArrayViewMut2::from_shape((pixels, outputs), out).expect("whole pixels");
        general_mat_mul(1.0, &columns, &self.kernel, 1.0, &mut product);
        product.mapv_inplace(|value| value.max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;
    use crate::weights::Tensor;

    fn noise(count: usize, seed: u32) -> Vec<f32> {
        let rng = Rng::new(3);
        (0..count as u32).map(|i| rng.at(Stream::Test, seed, i, 0).uniform(0) - 0.5).collect()
    }

    /// One output by the definition of a convolution, with torchvision's order of weights.
    fn direct(shape: &Shape, input: &Features, weight: &[f32], bias: f32, [x, y, output]: [usize; 3]) -> f32 {
        let side = shape.kernel;
        let mut sum = f64::from(bias);
        for at in 0..shape.inputs * side * side {
            let (channel, row, column) = (at / (side * side), at / side % side, at % side);
            let [px, py] =
                [x * shape.stride + column, y * shape.stride + row].map(|at| at.wrapping_sub(shape.padding));
            if px < input.width && py < input.height {
                let value = input.values[(py * input.width + px) * shape.inputs + channel];
                sum += f64::from(value * weight[output * shape.inputs * side * side + at]);
            }
        }
        sum.max(0.0) as f32
    }

    #[test]
    fn strips_of_products_equal_the_definition() {
        // VGG's kind over several strips, AlexNet's first kind, and one wider than its picture.
        for (kernel, stride, padding, width, height) in
            [(3, 1, 1, 37, 23), (11, 4, 2, 41, 31), (5, 1, 2, 2, 3)]
        {
            let shape = Shape { index: 0, inputs: 3, outputs: 4, kernel, stride, padding };
            let weight = Tensor { shape: Vec::new(), values: noise(4 * 3 * kernel * kernel, 0) };
            let bias = Tensor { shape: vec![4], values: noise(4, 1) };
            let tensors = shape.names().into_iter().zip([weight.clone(), bias.clone()]).collect();
            let input = Features { width, height, channels: 3, values: noise(3 * width * height, 2) };
            let out = Convolution::new(shape, &tensors).apply(&input);
            for (at, &value) in out.values.iter().enumerate() {
                let place = [at / 4 % out.width, at / 4 / out.width, at % 4];
                let expected = direct(&shape, &input, &weight.values, bias.values[at % 4], place);
                assert!((value - expected).abs() < 1e-5, "{kernel}: {place:?}: {value} against {expected}");
            }
            assert!(out.values.contains(&0.0) && out.values.iter().any(|&value| value > 0.0), "rectified");
        }
    }

    #[test]
    fn pooling_takes_the_largest_of_each_window() {
        let input =
            Features { width: 5, height: 3, channels: 1, values: (0..15).map(|i| i as f32).collect() };
        assert_eq!(input.max_pool(2).values, [6.0, 8.0]);
        assert_eq!(input.max_pool(3).values, [12.0, 14.0]);
    }

    #[test]
    fn inputs_are_scaled_as_the_authors_do() {
        let photo = Photo { width: 1, height: 1, rgb: vec![0, 255, 255] };
        let values = |range| Features::of_photo(&photo, range).values;
        let close = |a: Vec<f32>, b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(close(values(InputRange::ZeroToOne), [0.03 / 0.458, 1.088 / 0.448, 1.188 / 0.45]));
        assert!(close(values(InputRange::MinusOneToOne), [-0.97 / 0.458, 1.088 / 0.448, 1.188 / 0.45]));
    }
}
