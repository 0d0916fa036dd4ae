//! LPIPS: against the authors' own figures where the weights are at hand; and weights that are partial, wrong
//! or absent.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, resize, write_png};
use genesplat::metrics::Lpips;
use genesplat::metrics::lpips::{InputRange, Net, WeightError};
use genesplat::metrics::weights::{NamedTensors, Tensor, read_weights, to_safetensors};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{command, fail, json, real_data, run, scene, succeed, text, train};

/// How far a figure may be from the authors' (their f32 against ours, and weights in f16).
const TOLERANCE: f64 = 1e-3;

fn file_of(net: Net) -> &'static str {
    match net {
        Net::Vgg16 => "lpips_vgg16_f16.safetensors",
        Net::AlexNet => "lpips_alexnet.safetensors",
    }
}

/// The folder with the weights, the pairs of pictures and the authors' figures.
fn real_weights() -> Option<PathBuf> {
    real_data().map(|data| data.join("lpips"))
}

fn figures(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|figure| figure.as_f64().unwrap()).collect()
}

/// Pairs of pictures, and the authors' figures for them.
fn pairs(folder: &Path) -> Vec<Value> {
    json(&folder.join("reference.json"))["pairs"].as_array().unwrap().clone()
}

/// 64x64 pixels; the others have 400x300.
fn is_small(pair: &Value) -> bool {
    pair["size"] == serde_json::json!([64, 64])
}

/// The worst distance from the authors' figures, over these pairs and all layers; and in the other
/// convention, of whose figures only those for VGG16 are known, over the small pairs and one more: to both,
/// all but the range of the pixels is common.
fn worst_error(folder: &Path, metric: &Lpips, pairs: &[Value]) -> f64 {
    let name = metric.net().name();
    let mut worst = 0f64;
    for pair in pairs {
        let [a, b] = ["a", "b"]
            .map(|key| read_photo(&folder.join("pairs").join(pair[key].as_str().unwrap())).unwrap());
        let layers = metric.layers(&a, &b, InputRange::MinusOneToOne).unwrap();
        let mut errors: Vec<f64> = layers
            .iter()
            .zip(figures(&pair[format!("{name}_per_layer")]))
            .map(|(a, b)| (a - b).abs())
            .collect();
        errors.push((layers.iter().sum::<f64>() - pair[name].as_f64().unwrap()).abs());
        if metric.net() == Net::Vgg16 && (is_small(pair) || pair["b"] == "bonsai_b.png") {
            let published = pair["vgg16_inputs01_as_inria_metrics_py"].as_f64().unwrap();
            errors.push((metric.distance(&a, &b, InputRange::ZeroToOne).unwrap() - published).abs());
        }
        worst = errors.into_iter().fold(worst, f64::max);
    }
    worst
}

#[test]
fn all_figures_are_those_of_the_authors() {
    let Some(folder) = real_weights() else { return };
    for net in Net::ALL {
        let tensors = read_weights(&folder.join(file_of(net)), |_| true).unwrap();
        let worst = worst_error(&folder, &Lpips::new(net, &tensors).unwrap(), &pairs(&folder));
        assert!(worst < TOLERANCE, "{net}: {worst}");
        eprintln!("{net}: at most {worst:.1e} from the authors' figures");
    }
}

#[test]
fn one_wrong_weight_is_noticed() {
    let Some(folder) = real_weights() else { return };
    let net = Net::AlexNet;
    let mut tensors = read_weights(&folder.join(file_of(net)), |_| true).unwrap();
    let small: Vec<Value> = pairs(&folder).into_iter().filter(is_small).collect();
    assert!(worst_error(&folder, &Lpips::new(net, &tensors).unwrap(), &small) < TOLERANCE);
    for name in ["features.3.weight", "lin2.weight"] {
        let whole = tensors[name].clone();
        tensors.get_mut(name).unwrap().values[7] += 2.0;
        let worst = worst_error(&folder, &Lpips::new(net, &tensors).unwrap(), &small);
        assert!(worst > TOLERANCE, "{name}: {worst}");
        tensors.insert(name.into(), whole);
    }
}

#[test]
fn two_pictures_are_compared_by_both_conventions() {
    let Some(folder) = real_weights() else { return };
    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("scores.json");
    let [a, b] = ["ex_ref.png", "ex_p1.png"].map(|name| folder.join("pairs").join(name));
    let arguments = ["evaluate", text(&a), text(&b), "--lpips-weights", text(&folder), "--json", text(&file)];
    let said = succeed(arguments);
    assert!(said.contains("VGG16    0.4050") && said.contains("0.4216") && said.contains("0.1375"), "{said}");
    let scores = json(&file);
    let by_network = &scores["lpips_by_network"];
    assert_eq!(scores["lpips"], by_network["vgg16"]["zero_to_one"]);
    assert!((by_network["alexnet"]["minus_one_to_one"].as_f64().unwrap() - 0.137_566).abs() < TOLERANCE);
}

/// Weights of the right shapes and no meaning: small pseudo-random values.
fn invented(net: Net) -> NamedTensors {
    let mut state = 1u32;
    let mut value = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 * 0.1 - 0.04
    };
    let tensor = |shape: Vec<usize>, value: &mut dyn FnMut() -> f32| Tensor {
        values: (0..shape.iter().product()).map(|_| value()).collect(),
        shape,
    };
    net.tensors().map(|(name, shape)| (name, tensor(shape, &mut value))).collect()
}

/// A folder with invented weights for `net`, split into convolutions and heads as they are published.
fn two_files(net: Net) -> (TempDir, [PathBuf; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let (heads, mut convolutions): (NamedTensors, NamedTensors) =
        invented(net).into_iter().partition(|(name, _)| name.starts_with("lin"));
    // What torchvision's file holds besides.
    convolutions.insert("classifier.0.bias".into(), Tensor { shape: vec![2], values: vec![1.0; 2] });
    let files = ["network.safetensors", "heads.safetensors"].map(|name| folder.path().join(name));
    for (file, tensors) in files.iter().zip([&convolutions, &heads]) {
        fs::write(file, to_safetensors(tensors)).unwrap();
    }
    (folder, files)
}

#[test]
fn tensors_survive_the_disk() {
    let (_folder, [network, _]) = two_files(Net::AlexNet);
    let read = read_weights(&network, |name| name == "features.3.bias").unwrap();
    let wanted = ["features.3.bias"].map(|name| (name.to_owned(), invented(Net::AlexNet)[name].clone()));
    assert_eq!(read, BTreeMap::from(wanted));
}

#[test]
fn installed_weights_are_used_by_every_command_and_can_be_switched_off() {
    let (folder, [network, heads]) = two_files(Net::Vgg16);
    let (cache, out) = (folder.path().join("cache"), folder.path().join("run"));
    let in_cache = |arguments: &[&str]| {
        let output = command(arguments).env("XDG_CACHE_HOME", &cache).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap() + &String::from_utf8(output.stderr).unwrap()
    };
    let said = in_cache(&["evaluate", "--install-lpips", text(&network), text(&heads)]);
    assert!(said.contains("is not known here") && said.contains("VGG16 is installed"), "{said}");
    assert_eq!(fs::read_dir(cache.join("genesplat/lpips")).unwrap().count(), 1, "no litter");

    let arguments = train(scene(), &out, &["--iterations", "10", "--max-side", "32"]);
    let said = in_cache(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(said.contains("LPIPS 0.") && !said.contains("not measured"), "{said}");
    let metrics = json(&out.join("metrics.json"));
    for split in ["test", "train"] {
        let views = metrics[split]["views"].as_array().unwrap();
        let mean = views.iter().map(|view| view["lpips"].as_f64().unwrap()).sum::<f64>() / views.len() as f64;
        assert!(mean > 0.0 && (mean - metrics[split]["lpips"].as_f64().unwrap()).abs() < 1e-12);
    }
    // Pixels go in as the reference's metrics.py has them, from 0 to 1.
    let view = metrics["test"]["views"][0].clone();
    let name = view["name"].as_str().unwrap();
    let picture = out.join("test").join(Path::new(name).with_extension("png"));
    let Photo { width, height, .. } = read_photo(&picture).unwrap();
    let photo = folder.path().join("photo.png");
    write_png(&photo, &resize(&read_photo(&scene().join("images").join(name)).unwrap(), width, height))
        .unwrap();
    let compared = folder.path().join("compared.json");
    in_cache(&["evaluate", text(&picture), text(&photo), "--json", text(&compared)]);
    let distances = json(&compared)["lpips_by_network"]["vgg16"].clone();
    assert_eq!(view["lpips"], distances["zero_to_one"]);
    assert_ne!(view["lpips"], distances["minus_one_to_one"]);
    let file = folder.path().join("scores.json");
    let evaluate = ["evaluate", text(&out), "--data", text(scene()), "--json", text(&file)];
    in_cache(&evaluate);
    assert_eq!(json(&file)["lpips"], metrics["test"]["lpips"]);
    let said = in_cache(&[&evaluate[..], &["--no-lpips"]].concat());
    assert!(json(&file)["lpips"].is_null() && !said.contains("LPIPS"), "{said}");
    // The variable and the flag win over the cache folder.
    let nowhere = folder.path().join("nowhere");
    let output =
        command(evaluate).env("XDG_CACHE_HOME", &cache).env("GENESPLAT_LPIPS", &nowhere).output().unwrap();
    assert!(String::from_utf8_lossy(&output.stderr).contains("no LPIPS weights at"));
    // Set to nothing, it is not set.
    let output = command(evaluate).env("XDG_CACHE_HOME", &cache).env("GENESPLAT_LPIPS", "").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(json(&file)["lpips"], metrics["test"]["lpips"], "those of the cache folder");
    let arguments = [&evaluate[..], &["--lpips-weights", text(folder.path())]].concat();
    succeed(arguments);
    assert_eq!(json(&file)["lpips"], metrics["test"]["lpips"], "the same weights in two files");
}

/// LPIPS of many photos takes minutes; who presses Ctrl-C then is told that it stops, has a whole splat, and
/// can have it scored without another step.
#[cfg(unix)]
#[test]
fn scoring_is_stopped_between_photos() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    let (weights, _) = two_files(Net::Vgg16);
    let out = weights.path().join("run");
    let arguments = train(scene(), &out, &["--iterations", "3", "--lpips-weights", text(weights.path())]);
    let child = command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(100);
    while !out.join("point_cloud.ply").exists() {
        assert!(Instant::now() < deadline, "training never ended");
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.code() == Some(130) && said.contains("--resume"), "{said}");
    assert!(["metrics.json", "report.html"].iter().all(|name| !out.join(name).exists()));
    let [splat, log] = ["point_cloud.ply", "log.jsonl"].map(|name| fs::read(out.join(name)).unwrap());
    succeed(train(scene(), &out, &["--resume", "--lpips-weights", text(weights.path())]));
    assert_eq!(json(&out.join("metrics.json"))["iterations"], 3);
    assert_eq!(fs::read(out.join("point_cloud.ply")).unwrap(), splat);
    let more = fs::read(out.join("log.jsonl")).unwrap().split_off(log.len());
    assert!(!String::from_utf8(more).unwrap().contains("\"step\""));
    assert!(!out.join("checkpoint/latest.checkpoint").exists());
}

#[test]
fn without_weights_one_sentence_says_how_to_get_them() {
    let [a, b] = ["gallery_000.png", "gallery_001.png"].map(|name| scene().join("images").join(name));
    let output = run(["evaluate", text(&a), text(&b)]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && stderr.lines().count() == Net::ALL.len(), "{stderr}");
    assert!(stderr.lines().all(|line| line.contains("--install-lpips")), "{stderr}");
    let output = run(["evaluate", text(&a), text(&b), "--no-lpips"]);
    assert!(output.status.success() && output.stderr.is_empty());
}

#[test]
fn weights_that_cannot_be_used() {
    let (folder, [network, heads]) = two_files(Net::AlexNet);
    let install = |files: &[&Path], words: &[&str]| {
        fail(["evaluate", "--install-lpips"].into_iter().chain(files.iter().map(|file| text(file))), words);
    };
    install(&[&network], &["AlexNet", "lin0.weight", "both files"]);
    install(&[&heads], &["AlexNet", "features.0.weight", "both files"]);

    let partial = folder.path().join("partial.safetensors");
    fs::write(&partial, &fs::read(&network).unwrap()[..5_000_000]).unwrap();
    install(&[&partial, &heads], &["partial.safetensors", "no whole"]);
    let text_file = folder.path().join("readme.txt");
    fs::write(&text_file, "no weights").unwrap();
    install(&[&text_file], &["readme.txt", "no whole"]);
    install(&[&folder.path().join("absent.pth")], &["absent.pth", "cannot read"]);

    let promising = folder.path().join("alexnet-7be5be79.pth");
    fs::copy(&network, &promising).unwrap();
    install(&[&promising, &heads], &["promises", "7be5be79", "download it again"]);

    let other = folder.path().join("other.safetensors");
    let bias = Tensor { shape: vec![1], values: vec![0.0] };
    fs::write(&other, to_safetensors(&[("bert.bias".to_owned(), bias)].into())).unwrap();
    install(&[&other], &["other.safetensors", "neither VGG16 nor AlexNet"]);
    let mut bent = invented(Net::AlexNet);
    bent.insert("features.6.weight".into(), Tensor { shape: vec![2, 2], values: vec![0.0; 4] });
    fs::write(&other, to_safetensors(&bent)).unwrap();
    install(&[&other], &["other.safetensors", "neither VGG16 nor AlexNet"]);
    bent = invented(Net::AlexNet);
    bent.get_mut("lin1.weight").unwrap().values[3] = f32::NAN;
    fs::write(&other, to_safetensors(&bent)).unwrap();
    install(&[&other], &["lin1.weight", "not finite"]);
}

#[test]
fn shapes_are_checked_one_by_one() {
    let whole = invented(Net::AlexNet);
    for (name, shape) in Net::AlexNet.tensors() {
        let mut tensors = whole.clone();
        tensors.get_mut(&name).unwrap().shape.push(1);
        let error = Lpips::new(Net::AlexNet, &tensors).unwrap_err();
        assert!(matches!(&error, WeightError::Shape { wanted, .. } if *wanted == shape), "{error}");
        tensors.remove(&name);
        let missing = WeightError::Missing { net: Net::AlexNet, tensor: name };
        assert_eq!(Lpips::new(Net::AlexNet, &tensors).unwrap_err(), missing);
    }
}
