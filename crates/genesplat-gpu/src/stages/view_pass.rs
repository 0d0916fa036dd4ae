//! From cameras, settings and learning rates to what kernels read.

use genesplat_core::backend::{McmcStep, Update};
use genesplat_core::constants::JACOBIAN_LIMIT;
use genesplat_core::{Camera, Channels, DensitySignal, RenderSettings, ScreenFilter, StatisticsRequest};

use crate::layout::{
    FILTER_ANTIALIASED, FILTER_CLASSIC, FILTER_MIP, Optimiser, SIGNAL_ABSOLUTE, SIGNAL_NONE, SIGNAL_PIXELS,
    SIGNAL_SIGNED, TILE, ViewPass,
};

impl ViewPass {
    /// A cloud of `rows` rows as `camera` sees it.
    pub(crate) fn new(camera: &Camera, settings: &RenderSettings, rows: u64) -> Self {
        let rotation = camera.rotation();
        let translation = camera.camera_from_world_translation.to_array();
        let row = |index: usize| {
            let [x, y, z] = rotation.row(index).to_array().map(|value| value as f32);
            [x, y, z, translation[index] as f32]
        };
        let [cx, cy, cz] = camera.centre_in_world().to_array().map(|value| value as f32);
        let limit = camera.tan_half_fov().map(|tan| (f64::from(JACOBIAN_LIMIT) * tan) as f32);
        let [red, green, blue] = settings.background;
        let nearest = match settings.channels {
            Channels::Rgb => 0.0,
            Channels::InverseDepth { nearest } => nearest,
        };
        Self {
            camera_x: row(0),
            camera_y: row(1),
            camera_z: row(2),
            centre: [cx, cy, cz, nearest],
            background: [red, green, blue, 0.0],
            focal_x: camera.focal_px[0] as f32,
            focal_y: camera.focal_px[1] as f32,
            axis_x: (camera.principal_px[0] - 0.5) as f32,
            axis_y: (camera.principal_px[1] - 0.5) as f32,
            limit_x: limit[0],
            limit_y: limit[1],
            dilation: settings.filter.dilation(),
            sh_degree: settings.sh_degree.into(),
            filter_kind: match settings.filter {
                ScreenFilter::Classic => FILTER_CLASSIC,
                ScreenFilter::Antialiased => FILTER_ANTIALIASED,
                ScreenFilter::Mip => FILTER_MIP,
            },
            near: camera.near as f32,
            ..Self::of_splats([camera.width, camera.height], rows)
        }
    }

    /// A picture of so many splats on black.
    pub(crate) fn of_splats([width, height]: [u32; 2], splats: u64) -> Self {
        Self {
            width,
            height,
            tiles_x: width.div_ceil(TILE),
            tiles_y: height.div_ceil(TILE),
            rows: splats as u32,
            layers: 1,
            ..Self::default()
        }
    }

    /// The same, with what a step accumulates.
    pub(crate) fn with_statistics(self, request: StatisticsRequest) -> Self {
        let (signal, depth_threshold) = match request.density {
            None => (SIGNAL_NONE, 1.0),
            Some(DensitySignal::Signed) => (SIGNAL_SIGNED, 1.0),
            Some(DensitySignal::Absolute) => (SIGNAL_ABSOLUTE, 1.0),
            Some(DensitySignal::PixelWeighted { depth_threshold }) => (SIGNAL_PIXELS, depth_threshold),
        };
        Self { signal, depth_threshold, ..self }
    }

    /// The same, with the weight of a loss of inverse depth.
    pub(crate) fn with_depth_weight(mut self, weight: f32) -> Self {
        self.background[3] = weight;
        self
    }

    /// What is blended is inverse depth.
    pub(crate) fn is_of_depth(&self) -> bool {
        self.centre[3] > 0.0
    }

    pub(crate) fn tiles(&self) -> u64 {
        u64::from(self.tiles_x) * u64::from(self.tiles_y)
    }

    /// Bytes of a render, for all layers.
    pub(crate) fn image_bytes(&self) -> u64 {
        12 * u64::from(self.width) * u64::from(self.height) * u64::from(self.layers)
    }

    /// Bytes of the sums of the loss, for all layers.
    pub(crate) fn loss_sum_bytes(&self) -> u64 {
        48 * self.tiles() * u64::from(self.layers)
    }
}

impl Optimiser {
    pub(crate) fn new(update: &Update) -> Self {
        let rates = &update.rates;
        let [position, root] = Update::factors(rates.position, update.step);
        let [opacity, opacity_root] = Update::factors(rates.opacity, update.opacity_step);
        let rate = |rate: f32| Update::factors(rate, update.step)[0];
        let mut optimiser = Self {
            position,
            position_reach: rates.position_reach.unwrap_or(0.0),
            scale: rate(rates.scale),
            rotation: rate(rates.rotation),
            opacity,
            sh_dc: rate(rates.sh_dc),
            sh_rest: rate(rates.sh_rest),
            root,
            opacity_root: if update.opacity_step > 0 { opacity_root } else { 0.0 },
            ..Self::default()
        };
        if let Some(McmcStep { noise_scale, opacity_weight, scale_weight, rng, counter }) = update.mcmc {
            optimiser.is_mcmc = 1;
            (optimiser.noise_scale, optimiser.counter) = (noise_scale, counter);
            (optimiser.opacity_weight, optimiser.scale_weight) = (opacity_weight, scale_weight);
            [optimiser.key_low, optimiser.key_high] = rng.key();
        }
        optimiser
    }
}
