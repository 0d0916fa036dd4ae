//! Configuration files: every setting round-trips, any subset is enough, and mistakes get a sentence.

use std::collections::BTreeSet;

use genesplat_evolve::{Crossover, GeneticConfig, Magnitude};
use genesplat_train::{Background, MethodConfig, MethodName, StepBudget, TrainConfig};

#[test]
fn a_configuration_survives_its_file() {
    for method in MethodName::ALL {
        let config = TrainConfig { seed: (1 << 63) - 1, ..TrainConfig::of(method) };
        let defaults = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<TrainConfig>(&defaults).unwrap(), config);
    }
    let mut config = TrainConfig::of(MethodName::MipSplatting);
    (config.background, config.antialiasing) = (Background::Random, true);
    (config.max_gaussians, config.extra_steps) = (Some(1_000_000), Some(StepBudget::Steps(7)));
    (config.method.capacity, config.method.averaging) = (0.5, true);
    let (crossover, magnitude) = (Crossover::Uniform, Magnitude::Unit);
    config.genetic = Some(GeneticConfig { views: 3, crossover, magnitude, ..GeneticConfig::default() });
    let text = toml::to_string(&config).unwrap();
    assert!(text.contains(r#"name = "mip-splatting""#) && text.contains(r#"magnitude = "unit""#), "{text}");
    assert_eq!(toml::from_str::<TrainConfig>(&text).unwrap(), config);
}

#[test]
fn any_subset_is_a_configuration() {
    let read = |text: &str| toml::from_str::<TrainConfig>(text).unwrap();
    let searching = TrainConfig {
        iterations: 7000,
        genetic: Some(GeneticConfig::default()),
        ..TrainConfig::of(MethodName::ThreeDgs)
    };
    assert_eq!(read("iterations = 7000\nmethod = \"3dgs\"\n[genetic]"), searching);
    assert_eq!(read("iterations = 7000\n[method]\nname = \"3dgs\"\n[genetic]"), searching);
    let mut bold = searching;
    bold.genetic = Some(GeneticConfig { intensity: 0.5, ..GeneticConfig::default() });
    bold.method.averaging = true;
    let text = "iterations = 7000\n[method]\nname = \"3dgs\"\naveraging = true\n[genetic]\nintensity = 0.5";
    assert_eq!(read(text), bold);
    assert_eq!(read(""), TrainConfig::default());
}

#[test]
fn unknown_settings_are_errors_that_name_them() {
    for (text, wrong) in [
        ("iteration = 5", "`iteration`"),
        ("[method]\nuntill = 5", "`untill`"),
        ("[genetic]\nselected_by = \"error\"", "`selected_by`"),
        ("method = \"2dgs\"", "`2dgs`"),
        ("[method]\nname = \"3dgs\"\nnoise = 1.0", "`noise` is no setting of 3dgs"),
        ("[evolution]\nmode = \"renew\"", "`evolution`"),
    ] {
        let error = toml::from_str::<TrainConfig>(text).unwrap_err().to_string();
        assert!(error.contains(wrong), "{text}: {error}");
    }
}

#[test]
fn values_out_of_range_get_a_sentence() {
    type Change = fn(&mut TrainConfig);
    let cases: [(Change, &str); 23] = [
        (|c| c.iterations = 0, "iterations is 0, but must be at least 1"),
        (|c| (c.iterations, c.steps_scale) = (200_000, 1e3), "and at most 100 million"),
        (|c| c.seed = 1 << 63, "seed"),
        (|c| c.steps_scale = f64::NAN, "steps_scale is NaN"),
        (|c| c.sh_degree = 4, "sh_degree is 4, but must be between 0 and 3"),
        (|c| c.max_gaussians = Some(3), "max_gaussians"),
        (|c| (c.iterations, c.views_per_step) = (9, 9), "views_per_step"),
        (|c| c.max_gaussians = Some(usize::MAX), "max_gaussians"),
        (
            |c| c.method.position_rate_start = 0.0,
            "method.position_rate_start is 0, but must be a number above 0",
        ),
        (|c| c.method.position_rate_end = f64::INFINITY, "method.position_rate_end is inf"),
        (|c| c.method.feature_rate = f64::NAN, "method.feature_rate is NaN"),
        (|c| c.method.scale_rate = -1.0, "method.scale_rate is -1"),
        (|c| c.method.opacity_rate = -0.5, "method.opacity_rate is -0.5"),
        (|c| c.method.gradient_threshold = 0.0, "method.gradient_threshold is 0"),
        (|c| c.method.capacity = f64::NAN, "method.capacity is NaN"),
        (|c| c.method.densify_every = 0, "method.densify_every is 0, but must be at least 1"),
        (|c| c.method.reset_every = 0, "method.reset_every"),
        (|c| c.method.prune_size = 0.0, "method.prune_size"),
        (|c| c.method.growth = f64::INFINITY, "method.growth is inf"),
        (|c| c.method.noise = -1.0, "method.noise is -1, but must be a number that is not negative"),
        (
            |c| (c.method, c.antialiasing) = (MethodConfig::of(MethodName::MipSplatting), true),
            "antialiasing is true, but must be false with mip-splatting",
        ),
        (
            |c| c.genetic = Some(GeneticConfig { views: 0, ..GeneticConfig::default() }),
            "in genetic: views is 0",
        ),
        (
            |c| c.genetic = Some(GeneticConfig { population: 0, ..GeneticConfig::default() }),
            "in genetic: population",
        ),
    ];
    for (change, expected) in cases {
        let mut config = TrainConfig::default();
        change(&mut config);
        let error = config.resolve().unwrap_err().to_string();
        assert!(error.contains(expected), "wanted `{expected}` in `{error}`");
    }
}

#[test]
fn a_search_and_its_control_need_resets() {
    for method in MethodName::ALL {
        let (genetic, extra_steps) = (Some(GeneticConfig::default()), Some(StepBudget::Steps(7)));
        let searching = TrainConfig { genetic, ..TrainConfig::of(method) };
        let control = TrainConfig { extra_steps, ..TrainConfig::of(method) };
        for config in [searching, control] {
            match config.validate() {
                Ok(()) => assert_ne!(method, MethodName::Mcmc),
                Err(error) => {
                    assert_eq!(method, MethodName::Mcmc);
                    let text = error.to_string();
                    assert!(
                        text.starts_with("method.name is mcmc, but must be a method that resets opacities"),
                        "{text}"
                    );
                }
            }
        }
    }
}

#[test]
fn extra_steps_are_a_control_and_run_beside_nothing_else() {
    for budget in [StepBudget::Steps(7), StepBudget::Seconds(1.0)] {
        let mut config = TrainConfig { extra_steps: Some(budget), ..TrainConfig::of(MethodName::ThreeDgs) };
        config.validate().unwrap();
        config.genetic = Some(GeneticConfig::default());
        let text = config.validate().unwrap_err().to_string();
        assert!(text.contains("extra_steps is set, but must be left out beside genetic"), "{text}");
    }
    let mut config = TrainConfig::of(MethodName::ThreeDgs);
    config.extra_steps = Some(StepBudget::Seconds(-1.0));
    let error = config.validate().unwrap_err().to_string();
    assert!(error.contains("extra_steps.seconds is -1"), "{error}");
    (config.views_per_step, config.extra_steps) = (4, Some(StepBudget::Steps(7)));
    let error = config.validate().unwrap_err().to_string();
    assert!(error.contains("views_per_step is 4, but must be 1 with extra_steps"), "{error}");
}

#[test]
fn nothing_searches_unless_it_is_told_to() {
    assert_eq!(TrainConfig::default(), TrainConfig::of(MethodName::Genesplat));
    for method in MethodName::ALL {
        let TrainConfig { genetic, extra_steps, .. } = TrainConfig::of(method);
        assert_eq!((genetic, extra_steps), (None, None), "{method}");
    }
}

/// The settings below `value`, by their dotted names.
fn settings(value: &toml::Value, name: &str) -> Vec<String> {
    let below = |(key, value): (&String, &toml::Value)| settings(value, &format!("{name}.{key}"));
    value.as_table().map_or_else(|| vec![name.to_owned()], |table| table.iter().flat_map(below).collect())
}

/// Whoever adds a setting takes one away, or says here why there must be more.
#[test]
fn there_are_at_most_49_settings_and_14_of_one_method() {
    let mut all = BTreeSet::new();
    for method in MethodName::ALL {
        // Those that have no default that a file could name are set.
        let (genetic, extra_steps) = (Some(GeneticConfig::default()), Some(StepBudget::Steps(1)));
        let config = TrainConfig { max_gaussians: Some(9), genetic, extra_steps, ..TrainConfig::of(method) };
        let text = format!("{config:?}");
        assert!(!text.contains("None"), "a setting is not counted: {text}");
        let named = settings(&toml::Value::try_from(config).unwrap(), "");
        let own = named.iter().filter(|name| name.starts_with(".method.") && *name != ".method.name");
        assert!((1..=14).contains(&own.count()), "{method}: {named:?}");
        all.extend(named);
    }
    assert!(all.len() <= 49, "{} settings: {all:?}", all.len());
}

#[test]
fn defaults_are_those_of_the_method() {
    use MethodName::{Genesplat, ImprovedGs, Mcmc, MipSplatting, PixelGs, ThreeDgs};
    let all = |method| {
        let MethodConfig { position_rate_start: start, position_rate_end: end, opacity_rate, .. } =
            MethodConfig::of(method);
        ([start, end], opacity_rate, MethodConfig::of(method).gradient_threshold)
    };
    assert_eq!(all(Genesplat), ([1.6e-4, 2e-6], 0.025, 3e-4));
    assert_eq!(all(ImprovedGs), ([4e-5, 2e-6], 0.025, 3e-4));
    for method in [ThreeDgs, PixelGs, MipSplatting, Mcmc] {
        assert_eq!(all(method), ([1.6e-4, 1.6e-6], 0.05, 2e-4), "{method}");
    }
    for method in MethodName::ALL {
        let MethodConfig { capacity, gradual_growth, averaging, virtual_views, .. } =
            MethodConfig::of(method);
        let published = (0.0, false, false, 0);
        let expected = if method == Genesplat { (1.0, true, true, 250) } else { published };
        assert_eq!((capacity, gradual_growth, averaging, virtual_views), expected, "{method}");
    }
}

#[test]
fn methods_have_one_name_everywhere() {
    for method in MethodName::ALL {
        assert_eq!(method.to_string(), method.name());
        assert_eq!(serde_json::to_value(method).unwrap(), method.name());
        assert_eq!(MethodName::from_name(method.name()), Some(method));
    }
    assert_eq!(MethodName::from_name("renew"), None);
}
