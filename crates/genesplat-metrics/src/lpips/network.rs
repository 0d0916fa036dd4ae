//! The two networks whose features LPIPS compares, as tables.
//!
//! Names and shapes are torchvision's (`features.N.weight`, `[outputs, inputs, rows, columns]`), and the
//! heads' are `linK.weight`, `[1, channels, 1, 1]`. Features are taken ("tapped") after the last rectifier of
//! each slice.

use std::fmt;

/// Slices of a network, and so layers of the metric.
pub const LAYERS: usize = 5;

/// A network that LPIPS exists for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Net {
    /// VGG16 (Simonyan and Zisserman 2014), tapped after relu1_2, 2_2, 3_3, 4_3 and 5_3: that of published
    /// tables.
    Vgg16,
    /// AlexNet (Krizhevsky 2014), tapped after each of its five rectifiers. Ten times faster.
    AlexNet,
}

impl Net {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Vgg16, Self::AlexNet];

    /// As files and tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vgg16 => "vgg16",
            Self::AlexNet => "alexnet",
        }
    }

    /// Name and shape of every tensor that LPIPS needs, the convolutions' first.
    pub fn tensors(self) -> impl Iterator<Item = (String, Vec<usize>)> {
        let convolutions = self.slices().iter().flat_map(|slice| slice.convolutions).flat_map(|shape| {
            let Shape { outputs, inputs, kernel, .. } = *shape;
            let [weight, bias] = shape.names();
            [(weight, vec![outputs, inputs, kernel, kernel]), (bias, vec![outputs])]
        });
        let heads = self.slices().iter().enumerate();
        convolutions.chain(heads.map(|(layer, slice)| (head(layer), vec![1, slice.channels(), 1, 1])))
    }

    pub(super) fn slices(self) -> &'static [Slice; LAYERS] {
        match self {
            Self::Vgg16 => &VGG16,
            Self::AlexNet => &ALEXNET,
        }
    }

    /// Least side of a picture of which the last slice still sees a pixel, px.
    pub fn min_side_px(self) -> u32 {
        (1..).find(|&side| self.last_side(side as usize).is_some()).expect("a large picture passes")
    }

    /// Side of the last slice's features for a picture of side `px`, if anything is left of it.
    fn last_side(self, px: usize) -> Option<usize> {
        self.slices().iter().try_fold(px, |side, slice| {
            let pooled = slice.pool.map_or(Some(side), |window| places(side, window, POOL_STRIDE, 0))?;
            slice.convolutions.iter().try_fold(pooled, |side, shape| shape.output_side(side))
        })
    }
}

impl fmt::Display for Net {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vgg16 => "VGG16",
            Self::AlexNet => "AlexNet",
        })
    }
}

pub(super) fn head(layer: usize) -> String {
    format!("lin{layer}.weight")
}

/// Convolutions between two taps, each with a rectifier behind it.
#[derive(Debug)]
pub(super) struct Slice {
    /// Window of the max pooling that comes first, if one does; its stride is [`POOL_STRIDE`].
    pub(super) pool: Option<usize>,
    pub(super) convolutions: &'static [Shape],
}

impl Slice {
    /// Channels of its tap.
    fn channels(&self) -> usize {
        self.convolutions.last().expect("every slice convolves").outputs
    }
}

/// Every max pooling of both networks halves its picture.
pub(super) const POOL_STRIDE: usize = 2;

/// A convolution with a square kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// Position in torchvision's `features`.
    pub(super) index: usize,
    /// Channels in and out.
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    /// Side of the kernel, pixels from one output to the next, and zeros around the picture, px.
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

impl Shape {
    /// Names of its kernel and its bias.
    pub(super) fn names(&self) -> [String; 2] {
        ["weight", "bias"].map(|part| format!("features.{}.{part}", self.index))
    }

    /// Outputs along a side of `side` px; `None` where the kernel does not fit.
    pub(super) fn output_side(&self, side: usize) -> Option<usize> {
        places(side, self.kernel, self.stride, self.padding)
    }
}

/// Places of a window on `side` px with `padding` more at both ends; `None` where it does not fit.
pub(super) fn places(side: usize, window: usize, stride: usize, padding: usize) -> Option<usize> {
    Some((side + 2 * padding).checked_sub(window)? / stride + 1)
}

const fn convolution(
    index: usize,
    [inputs, outputs]: [usize; 2],
    [kernel, stride, padding]: [usize; 3],
) -> Shape {
    Shape { index, inputs, outputs, kernel, stride, padding }
}

const fn three(index: usize, inputs: usize, outputs: usize) -> Shape {
    convolution(index, [inputs, outputs], [3, 1, 1])
}

const VGG16: [Slice; LAYERS] = [
    Slice { pool: None, convolutions: &[three(0, 3, 64), three(2, 64, 64)] },
    Slice { pool: Some(2), convolutions: &[three(5, 64, 128), three(7, 128, 128)] },
    Slice { pool: Some(2), convolutions: &[three(10, 128, 256), three(12, 256, 256), three(14, 256, 256)] },
    Slice { pool: Some(2), convolutions: &[three(17, 256, 512), three(19, 512, 512), three(21, 512, 512)] },
    Slice { pool: Some(2), convolutions: &[three(24, 512, 512), three(26, 512, 512), three(28, 512, 512)] },
];

const ALEXNET: [Slice; LAYERS] = [
    Slice { pool: None, convolutions: &[convolution(0, [3, 64], [11, 4, 2])] },
    Slice { pool: Some(3), convolutions: &[convolution(3, [64, 192], [5, 1, 2])] },
    Slice { pool: Some(3), convolutions: &[three(6, 192, 384)] },
    Slice { pool: None, convolutions: &[three(8, 384, 256)] },
    Slice { pool: None, convolutions: &[three(10, 256, 256)] },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_consistent() {
        for net in Net::ALL {
            let shapes: Vec<&Shape> = net.slices().iter().flat_map(|slice| slice.convolutions).collect();
            assert_eq!(shapes[0].inputs, 3);
            assert!(shapes.windows(2).all(|pair| pair[0].outputs == pair[1].inputs), "{net}");
        }
        // 13 convolutions and 5 heads; the sizes of the published models without their classifiers.
        let count =
            |net: Net| -> usize { net.tensors().map(|(_, shape)| shape.iter().product::<usize>()).sum() };
        assert_eq!(Net::Vgg16.tensors().count(), 31);
        assert_eq!(count(Net::Vgg16), 14_714_688 + 1472);
        assert_eq!(count(Net::AlexNet), 2_469_696 + 1152);
    }

    #[test]
    fn small_pictures_vanish_on_the_way() {
        // Four halvings; and 31 -> 7 -> 3 -> 1 through AlexNet's first slices.
        assert_eq!((Net::Vgg16.min_side_px(), Net::AlexNet.min_side_px()), (16, 31));
        assert_eq!(Net::Vgg16.last_side(512), Some(32));
        assert_eq!(Net::AlexNet.last_side(224), Some(13));
    }
}
