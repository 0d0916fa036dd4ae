use genesplat_train::{MethodConfig, MethodName};

use super::*;

#[test]
fn a_file_wins_over_what_a_command_does_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let iterations = |text: &str| {
        let file = folder.path().join("config.toml");
        std::fs::write(&file, text).unwrap();
        let defaults = Table::from_iter([("iterations".to_owned(), Value::from(2000))]);
        ConfigFile::read_over(&file, defaults).unwrap().train.iterations
    };
    assert_eq!((iterations("seed = 1"), iterations("iterations = 7")), (2000, 7));
}

#[test]
fn the_first_difference_is_named_with_both_values() {
    let (dataset, train) = (Dataset::default(), TrainConfig::default());
    let difference = |dataset: &Dataset, other: &TrainConfig| {
        first_difference(&result_settings(&Dataset::default(), &train), &result_settings(dataset, other))
    };
    let elsewhere = Dataset { path: "elsewhere".into(), ..Dataset::default() };
    let as_often = TrainConfig { checkpoint_every: 7, ..train.clone() };
    assert_eq!(difference(&elsewhere, &as_often), None);

    let small = Dataset { max_side: Some(64), ..dataset.clone() };
    let said = difference(&small, &train);
    assert_eq!(said.as_deref(), Some("dataset.max_side is not set there and 64 here"));
    let mut other = train.clone();
    other.method.capacity = 0.5;
    let said = difference(&dataset, &other);
    assert_eq!(said.as_deref(), Some("method.capacity is 1.0 there and 0.5 here"));
    other.method = MethodConfig::of(MethodName::Mcmc);
    let said = difference(&dataset, &other);
    assert!(said.is_some_and(|said| said.starts_with("method.")));
    let other = TrainConfig { max_gaussians: Some(9), seed: 4, ..train.clone() };
    let said = difference(&dataset, &other);
    assert_eq!(said.as_deref(), Some("seed is 0 there and 4 here"));
}

#[test]
fn settings_of_old_files_have_a_sentence_with_the_new_one() {
    let refused =
        |text: &str| ConfigFile::from_table(text.parse().unwrap()).unwrap_err().message().to_owned();
    for (old, new) in [
        ("variant = \"mcmc\"", "[method] name = \"mcmc\""),
        ("[evolution]\nmode = \"renew\"", "name = \"genesplat\""),
        ("[evolution]\nmode = \"paper\"", "[genetic]"),
        ("[densify]\nevery = 7", "[method]"),
        ("[optimiser]\nscale = 7", "[method]"),
        ("[mcmc]\nnoise = 7", "[method]"),
        ("extent = 7", "leave it out"),
    ] {
        let sentence = refused(old);
        assert!(sentence.contains(new), "{old}: {sentence}");
    }
}
