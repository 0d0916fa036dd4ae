//! Counter-based randomness: every number is a function of (seed, stream, three counters), so neither
//! threads, nor the device, nor a resume change a result.
//!
//! The generator is Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011).

/// What a random number is for. Two streams never share numbers, whatever their counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Stream {
    /// Order of the training views: (epoch, position, 0).
    ViewOrder = 1,
    /// Offsets of split children: (iteration, old row, child).
    SplitOffset = 2,
    /// Random backgrounds: (iteration, extra step, 0).
    Background = 3,
    /// Points of a scene that has none: (0, row, 0).
    InitialPoints = 4,
    /// Choice of the views that fitness is measured on: (stage, 0, 0).
    FitnessViews = 5,
    /// Which Gaussians of an individual are selected: (generation, individual, draw / 4).
    GeneSelection = 6,
    /// Which genes mutate, and by how much: (generation, individual, 3 row + draw).
    Mutation = 7,
    /// Tournament draws: (generation, pair, draw).
    Tournament = 8,
    /// Crossover points and coin flips: (generation, pair, position).
    Crossover = 9,
    /// SGLD noise of MCMC: (optimiser step, row, 0).
    SgldNoise = 10,
    /// Draws of MCMC's density control: (iteration, draw, 0 for relocation or 1 for growth).
    Relocation = 11,
    /// The bundled scene: (purpose, index, draw).
    Gallery = 12,
    /// Tests and benches.
    Test = 13,
    /// Which Gaussians Improved-GS splits: (iteration, row, 0).
    SplitChoice = 14,
    /// Rounding of the pictures of virtual views: (iteration, view, pixel).
    VirtualPicture = 16,
    /// Which virtual views are looked at again: (iteration, position, 0).
    VirtualTurn = 17,
}

/// The random numbers of one seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rng {
    key: [u32; 2],
}

impl Rng {
    /// All streams of `seed`.
    pub fn new(seed: u64) -> Self {
        Self { key: [seed as u32, (seed >> 32) as u32] }
    }

    /// The key of the generator, for devices that draw themselves.
    pub fn key(&self) -> [u32; 2] {
        self.key
    }

    /// Streams of their own: for each evolution stage, for orders of views beside that of training, and for
    /// virtual views.
    pub fn fork(self, index: u32) -> Self {
        let [a, b, ..] = philox4x32_10([index, 0x6765_6e65, 0x666f_726b, 0], self.key);
        Self { key: [a, b] }
    }

    /// Four independent 32-bit words for one address.
    #[inline]
    pub fn at(&self, stream: Stream, a: u32, b: u32, c: u32) -> Draw {
        Draw(philox4x32_10([a, b, c, stream as u32], self.key))
    }

    /// A permutation of `0..n` (Fisher-Yates), addressed by `(stream, a)`.
    pub fn permutation(&self, stream: Stream, a: u32, n: usize) -> Vec<u32> {
        let mut order: Vec<u32> = (0..n as u32).collect();
        for last in (1..n).rev() {
            let pick = self.at(stream, a, last as u32, 0).below(0, last as u32 + 1);
            order.swap(last, pick as usize);
        }
        order
    }
}

/// Four random words, read as the caller needs them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draw(pub [u32; 4]);

impl Draw {
    /// Uniform in `[0, 1)` with 24 bits.
    #[inline]
    pub fn uniform(&self, word: usize) -> f32 {
        (self.0[word] >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `0..n` (multiply-shift; biased by `n/2³²`).
    #[inline]
    pub fn below(&self, word: usize, n: u32) -> u32 {
        ((u64::from(self.0[word]) * u64::from(n)) >> 32) as u32
    }

    /// Two standard normal numbers from words `2·pair` and `2·pair + 1` (Box-Muller).
    #[inline]
    pub fn normals(&self, pair: usize) -> [f32; 2] {
        // (0, 1]: the logarithm never sees zero.
        let u = (f64::from(self.0[2 * pair]) + 1.0) * (1.0 / 4_294_967_296.0);
        let v = f64::from(self.0[2 * pair + 1]) * (std::f64::consts::TAU / 4_294_967_296.0);
        let radius = (-2.0 * u.ln()).sqrt();
        [(radius * v.cos()) as f32, (radius * v.sin()) as f32]
    }
}

/// Ten rounds of Philox4x32.
#[inline]
pub fn philox4x32_10(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let p0 = u64::from(counter[0]) * 0xD251_1F53;
        let p1 = u64::from(counter[2]) * 0xCD9E_8D57;
        counter = [
            (p1 >> 32) as u32 ^ counter[1] ^ key[0],
            p1 as u32,
            (p0 >> 32) as u32 ^ counter[3] ^ key[1],
            p0 as u32,
        ];
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the Random123 library.
    #[test]
    fn known_answers() {
        assert_eq!(philox4x32_10([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            philox4x32_10([u32::MAX; 4], [u32::MAX; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
        assert_eq!(
            philox4x32_10([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn normals_have_unit_variance() {
        let rng = Rng::new(7);
        let values: Vec<f32> = (0..20_000)
            .flat_map(|i| {
                let draw = rng.at(Stream::Test, 0, i, 0);
                [draw.normals(0), draw.normals(1)].concat()
            })
            .collect();
        let n = values.len() as f64;
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        let variance = values.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>() / n;
        // Four standard errors of the mean and of the variance of 80,000 normal draws.
        assert!(mean.abs() < 4.0 / n.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{variance}");
    }

    #[test]
    fn all_orders_are_equally_likely() {
        let mut counts = std::collections::BTreeMap::new();
        for a in 0..6000 {
            *counts.entry(Rng::new(3).permutation(Stream::ViewOrder, a, 3)).or_insert(0u32) += 1;
        }
        // Four standard errors.
        assert!(counts.len() == 6 && counts.values().all(|count| count.abs_diff(1000) < 116), "{counts:?}");
    }

    #[test]
    fn a_permutation_holds_every_index_once_and_differs_between_epochs() {
        let rng = Rng::new(3);
        let mut first = rng.permutation(Stream::ViewOrder, 0, 43);
        assert_ne!(first, rng.permutation(Stream::ViewOrder, 1, 43));
        first.sort_unstable();
        assert!(first.iter().enumerate().all(|(i, &v)| i as u32 == v));
    }
}
