//! The command line as a whole.

use clap::CommandFactory;
use genesplat::io::MaskUse;

use super::*;

#[test]
fn the_definition_is_consistent() {
    Arguments::command().debug_assert();
}

/// The help of a command and of those below it, with the name of each.
fn helps(command: &mut clap::Command) -> Vec<(String, String)> {
    let own = (command.get_name().to_owned(), command.render_long_help().to_string());
    std::iter::once(own).chain(command.get_subcommands_mut().flat_map(helps)).collect()
}

/// Settings that a text names: two words with a full stop between them, and no file.
fn settings_in(text: &str) -> impl Iterator<Item = &str> {
    const FILES: [&str; 18] = [
        "bin",
        "compressed",
        "gif",
        "glb",
        "html",
        "jpeg",
        "jpg",
        "json",
        "jsonl",
        "mp4",
        "ply",
        "png",
        "pth",
        "sog",
        "splat",
        "spz",
        "toml",
        "txt",
    ];
    let is_word =
        |word: &str| !word.is_empty() && word.chars().all(|char| char.is_ascii_lowercase() || char == '_');
    let words = text.split(|char: char| !(char.is_ascii_alphanumeric() || "_./".contains(char)));
    words.map(|word| word.trim_end_matches('.')).filter(move |word| {
        let parts = word.split_once('.');
        parts.is_some_and(|(table, key)| is_word(table) && is_word(key) && !FILES.contains(&key))
    })
}

#[test]
fn settings_that_help_names_exist() {
    let problem = |setting: &str| {
        let file = genesplat::run::settings::ConfigFile::from_table(
            format!("{setting} = 'no value'").parse().unwrap(),
        );
        file.map_or_else(|error| error.message().to_owned(), |_| String::new())
    };
    assert!(problem("method.absolute_threshold").contains("unknown field"), "a name that is wrong is found");
    let helps = helps(&mut Arguments::command());
    let named: Vec<&str> = helps.iter().flat_map(|(_, help)| settings_in(help)).collect();
    for setting in named {
        assert!(!problem(setting).contains("unknown field"), "{setting}: {}", problem(setting));
    }
}

#[test]
fn help_speaks_of_runs_only_where_one_can_be_given() {
    for (name, help) in helps(&mut Arguments::command()) {
        let takes_one = ["SPLAT|RUN", "SCENE|SPLAT|RUN"].iter().any(|value| help.contains(value));
        assert!(takes_one || !help.contains("RUN"), "{name}: {help}");
    }
}

#[test]
fn whatever_shows_a_splat_takes_masks_and_a_near_plane() {
    let of_splat = |words: &str| match Arguments::try_parse_from(words.split(' ')).unwrap().command {
        Command::View(args) => (args.splat.path, args.splat.photos),
        Command::Export(args) => (args.splat.path, args.splat.photos),
        Command::Evaluate(args) => (args.path.unwrap(), args.photos),
        Command::Render(args) => (args.splat.path, args.splat.photos),
        _ => unreachable!("these four show splats"),
    };
    for command in ["view", "export --out a.html", "evaluate --data d", "render --data d --split all --out o"]
    {
        let (splat, photos) = of_splat(&format!("genesplat {command} a.ply --near 0.5 --mask usual"));
        let asked = photos.asked().unwrap();
        assert_eq!((splat, asked.mask, asked.near), ("a.ply".into(), Some(MaskUse::Usual), Some(0.5)));
    }
}

#[test]
fn flags_of_other_trainers_are_understood() {
    let train = |words: &str| match Arguments::try_parse_from(words.split(' ')).map(|parsed| parsed.command) {
        Ok(Command::Train(args)) => Ok(args),
        Ok(_) => unreachable!("it is train"),
        Err(error) => Err(error),
    };
    for words in ["--data a --output b --max-steps 9 --gpu", "a --out b --steps 9 --device gpu"] {
        let args = train(&format!("genesplat train {words}")).unwrap();
        let mut config = genesplat::train::TrainConfig::default();
        args.override_config(&mut config).unwrap();
        assert_eq!(
            (args.dataset(), &*args.out, config.iterations),
            ("a".as_ref(), "b".as_ref(), 9),
            "{words}"
        );
        assert_eq!(args.machine.device(), Some(DeviceChoice::Gpu), "{words}");
    }
    for words in ["--method MCMC", "--method 3DGS", "--preset Quick", "--background Black", "--mask OFF"] {
        assert!(train(&format!("genesplat train a --out b {words}")).is_ok(), "{words}");
    }
    for wrong in ["--out b", "a --data a --out b", "a --out b --gpu --device cpu"] {
        assert!(train(&format!("genesplat train {wrong}")).is_err(), "{wrong}");
    }
    let help = Arguments::command().find_subcommand_mut("train").unwrap().render_long_help().to_string();
    assert!(!help.contains("--data ") && !help.contains("--max-steps") && !help.contains("--gpu"), "{help}");
}
