//! Values that a flag takes by name, each with a line of help. The names are those of the configuration file.

use genesplat::flags::Choice;
use genesplat::io::MaskUse;
use genesplat::io::format::SpzVersion;
use genesplat::run::exposure::Corrections;
use genesplat::run::metrics::Split;
use genesplat::run::settings::DepthUse;
use genesplat::train::{Background, MethodName};

/// `--method`.
pub(crate) const METHODS: &[Choice<MethodName>] = &[
    (
        MethodName::Genesplat,
        &["genesplat", "ours"],
        "Ours: as many Gaussians as the photos can determine, which split where photos have edges; the mean of the last states",
    ),
    (MethodName::ThreeDgs, &["3dgs"], "3D Gaussian Splatting (Kerbl et al. 2023)"),
    (
        MethodName::PixelGs,
        &["pixel-gs"],
        "Pixel-GS (Zhang et al. 2024): adds Gaussians where many pixels need them",
    ),
    (
        MethodName::MipSplatting,
        &["mip-splatting"],
        "Mip-Splatting (Yu et al. 2024): stays sharp when seen from nearer or farther than the photos",
    ),
    (
        MethodName::Mcmc,
        &["mcmc"],
        "3DGS-MCMC (Kheradmand et al. 2024): Gaussians wander, dead ones move to where they are needed, up to --max-gaussians; \
         give it several thousand iterations",
    ),
    (
        MethodName::ImprovedGs,
        &["improved-gs"],
        "Improved-GS (Deng et al. 2025): splits where photos have edges, up to --max-gaussians; lower rates, fewer and larger \
         steps late",
    ),
];

/// `--preset`: a configuration file.
pub(crate) const PRESETS: &[Choice<&str>] = &[
    (
        "steps_scale = 0.1\n[dataset]\nmax_side = 640",
        &["quick"],
        "Minutes: photos of at most 640 pixels, and the whole schedule in a tenth of its steps",
    ),
    (
        "",
        &["standard"],
        "What no flag changes: photos of at most 1600 pixels across, 30000 steps, the published length",
    ),
    (
        "[dataset]\ndownscale = 1",
        &["best"],
        "All that the photos have: their full size, however large, over 30000 steps; takes the most memory and time",
    ),
];

const BLACK: Choice<Background> = (Background::Black, &["black"], "Black");
const WHITE: Choice<Background> = (Background::White, &["white"], "White");

/// `--background` of `train`.
pub(crate) const BACKGROUNDS: &[Choice<Background>] =
    &[BLACK, WHITE, (Background::Random, &["random"], "A new colour in every step; black when measured")];

/// `--background` of a finished splat.
pub(crate) const FIXED_BACKGROUNDS: &[Choice<Background>] = &[BLACK, WHITE];

/// `--corrections`.
pub(crate) const CORRECTIONS: &[Choice<Corrections>] = &[
    (Corrections::On, &["on"], "By what points that photos share say; an error where they say nothing"),
    (Corrections::Auto, &["auto"], "The same where they say something that is worth it, else off"),
    (Corrections::Off, &["off"], "Photos are trained on as they are"),
];

/// `--depth`.
pub(crate) const DEPTHS: &[Choice<DepthUse>] = &[
    (DepthUse::On, &["on"], "They do, with any method"),
    (DepthUse::Auto, &["auto"], "They do with genesplat; published methods know photos alone"),
    (DepthUse::Off, &["off"], "They are not looked for"),
];

/// `--mask`.
pub(crate) const MASKS: &[Choice<MaskUse>] = &[
    (MaskUse::Usual, &["usual"], "What masks hide does not count; what is transparent is background"),
    (
        MaskUse::Ignore,
        &["ignore"],
        "Neither what masks hide nor what is transparent counts, in training and in scores: people, cars, your own hand",
    ),
    (
        MaskUse::Transparent,
        &["transparent"],
        "What masks hide and what is transparent must be background: an object cut out of its photos",
    ),
    (MaskUse::Off, &["off"], "Masks are not looked for; what is transparent is background"),
];

/// `--split` of `evaluate`.
pub(crate) const SPLITS: &[Choice<Split>] = &[
    (Split::Test, &["test"], "Photos that training never saw"),
    (Split::Train, &["train"], "Photos that it saw"),
];

/// `--spz-version`.
pub(crate) const SPZ_VERSIONS: &[Choice<SpzVersion>] = &[
    (SpzVersion::V3, &["3"], "One gzip stream, which most viewers read"),
    (SpzVersion::V4, &["4"], "A zstd stream for each attribute: smaller, and newer"),
];

#[cfg(test)]
mod tests {
    use clap::builder::TypedValueParser;
    use genesplat::flags::choice;
    use genesplat::run::settings::ConfigFile;
    use serde::Serialize;

    use super::*;

    fn assert_named_as_in_files<T: Serialize>(choices: &[Choice<T>]) {
        for (value, names, _) in choices {
            assert_eq!(serde_json::to_value(value).unwrap(), names[0]);
        }
    }

    #[test]
    fn flags_name_values_as_files_do() {
        assert_named_as_in_files(METHODS);
        assert!(METHODS.iter().map(|choice| choice.0).eq(MethodName::ALL));
        assert_named_as_in_files(BACKGROUNDS);
        assert_named_as_in_files(FIXED_BACKGROUNDS);
        assert_named_as_in_files(MASKS);
        assert_named_as_in_files(SPLITS);
    }

    #[test]
    fn presets_are_configurations() {
        for (text, names, _) in PRESETS {
            let config = ConfigFile::from_table(text.parse().unwrap()).unwrap();
            config.check().unwrap_or_else(|error| panic!("{names:?}: {error}"));
        }
    }

    #[test]
    fn a_value_has_other_names_too() {
        let parser = choice(METHODS);
        let parsed = |name: &str| {
            let parsed = parser.parse_ref(&clap::Command::new("x"), None, std::ffi::OsStr::new(name));
            parsed.ok()
        };
        assert_eq!([parsed("genesplat"), parsed("ours")], [Some(MethodName::Genesplat); 2]);
        assert_eq!(parsed("2dgs"), None);
    }
}
