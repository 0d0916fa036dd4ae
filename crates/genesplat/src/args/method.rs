//! Options of the methods that users of other trainers know.

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use genesplat::train::config::Signal;
use genesplat::train::{Background, TrainConfig, Variant};

/// How Gaussians are shown, and what makes them grow.
#[derive(Clone, Debug, Default, Args)]
pub struct MethodArgs {
    /// Colour behind the scene [default: black]. White suits objects cut out of their photos; random keeps them opaque
    #[arg(long, value_enum, value_name = "COLOUR")]
    pub background: Option<BackgroundName>,
    /// Dim Gaussians smaller than a pixel instead of only widening them, so that views from afar do not swell.
    /// Not with --variant mip-splatting, which has a filter of its own
    #[arg(long)]
    pub antialiasing: bool,
    /// Gradient that makes a Gaussian grow, for 3dgs and mip-splatting [default: published]
    #[arg(long, value_enum, value_name = "SIGNAL")]
    pub densify_signal: Option<SignalName>,
}

impl MethodArgs {
    /// Fails where a flag does not go with the method that is trained.
    pub fn check(&self, variant: Variant) -> Result<()> {
        let has_own = matches!(variant, Variant::PixelGs | Variant::Mcmc);
        let asked = self.densify_signal.filter(|signal| *signal != SignalName::Published);
        ensure!(
            !has_own || asked.is_none(),
            "--densify-signal is for 3dgs and mip-splatting, and {variant} grows by a rule of its own; leave the flag out, or train \
             another --variant"
        );
        Ok(())
    }

    /// Flags over the file.
    pub fn override_method(&self, train: &mut TrainConfig) {
        if let Some(background) = self.background {
            train.background = background.into();
        }
        if let Some(signal) = self.densify_signal {
            train.densify.signal = signal.into();
        }
        train.antialiasing |= self.antialiasing;
    }
}

/// Backgrounds, as `--background` names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackgroundName {
    /// Black
    Black,
    /// White
    White,
    /// A new colour in every step; black when measured
    Random,
}

impl From<BackgroundName> for Background {
    fn from(name: BackgroundName) -> Self {
        match name {
            BackgroundName::Black => Self::Black,
            BackgroundName::White => Self::White,
            BackgroundName::Random => Self::Random,
        }
    }
}

/// What a finished splat is shown on.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct ShownOnArgs {
    /// Colour behind the splat, and behind photos that are transparent [default: that of the RUN; for a PLY, which does not say,
    /// black]
    #[arg(long, value_enum, value_name = "COLOUR")]
    pub background: Option<PlainBackground>,
}

/// Backgrounds that do not change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PlainBackground {
    /// Black
    Black,
    /// White
    White,
}

impl From<PlainBackground> for Background {
    fn from(name: PlainBackground) -> Self {
        match name {
            PlainBackground::Black => Self::Black,
            PlainBackground::White => Self::White,
        }
    }
}

/// Signals, as `--densify-signal` names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SignalName {
    /// The method's own
    Published,
    /// Absolute values ("absgrad" of gsplat): sharper details with fewer Gaussians; its threshold is
    /// densify.absolute_threshold of the configuration file
    #[value(alias = "absgrad")]
    Absolute,
    /// As in later releases of Mip-Splatting and in Gaussian Opacity Fields: grows about twice as many
    Gof,
}

impl From<SignalName> for Signal {
    fn from(name: SignalName) -> Self {
        match name {
            SignalName::Published => Self::Published,
            SignalName::Absolute => Self::Absolute,
            SignalName::Gof => Self::Gof,
        }
    }
}
