//! Where the weights of LPIPS come from: a flag, an environment variable, or the user's cache folder.
//!
//! A file may hold the convolutions of a network, the heads of LPIPS, or both; which network it belongs to is
//! told by names and shapes.

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use genesplat_io::shown;
use genesplat_metrics::Lpips;
use genesplat_metrics::lpips::{Net, belongs_to};
use genesplat_metrics::weights::{NamedTensors, read_weights};

use crate::output;

/// What somebody wants of LPIPS.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    /// A file of weights, or a folder of files; `None` for those of the environment, or that are installed.
    pub weights: Option<PathBuf>,
    /// Whether it is not measured, though its weights are there.
    pub is_left_out: bool,
}

/// The measure of published tables, VGG16; `None` where there are no weights for it.
pub fn open(asked: &Asked) -> Result<Option<Lpips>> {
    Ok(open_all(asked)?.into_iter().find(|metric| metric.net() == Net::Vgg16))
}

/// The same for who asks for figures: that LPIPS is not among them is said there, and not in every command.
pub fn open_or_notify(asked: &Asked) -> Result<Option<Lpips>> {
    let metric = open(asked)?;
    if metric.is_none() && !asked.is_left_out {
        notify_absent(Net::Vgg16);
    }
    Ok(metric)
}

/// The measure with every network whose weights are there.
pub fn open_all(asked: &Asked) -> Result<Vec<Lpips>> {
    if asked.is_left_out {
        return Ok(Vec::new());
    }
    let named = named(asked);
    let source = match &named {
        Some(path) if !path.exists() => bail!(
            "there are no LPIPS weights at {}, where --lpips-weights or GENESPLAT_LPIPS says; correct that, or give --no-lpips",
            shown(path)
        ),
        Some(path) => path.clone(),
        None => match cache_folder() {
            Some(folder) if folder.is_dir() => folder,
            _ => return Ok(Vec::new()),
        },
    };
    let pool = pool(&weight_files(&source)?)?;
    let metrics: Vec<Lpips> = pool
        .iter()
        .map(|(&net, tensors)| Lpips::new(net, tensors))
        .collect::<Result<_, _>>()
        .map_err(|error| anyhow!("{}: {error}; install the weights again", shown(&source)))?;
    if metrics.is_empty() && named.is_some() {
        bail!("{} holds no file of LPIPS weights; give a folder or a file that does", shown(source));
    }
    Ok(metrics)
}

/// The weights that somebody chose: the flag wins over the variable, and an empty one, as scripts leave it,
/// is none.
fn named(asked: &Asked) -> Option<PathBuf> {
    asked.weights.clone().or_else(|| path_in("GENESPLAT_LPIPS"))
}

fn path_in(variable: &str) -> Option<PathBuf> {
    env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// Says in one sentence that LPIPS with `net` is left out.
pub fn notify_absent(net: Net) {
    output::note(&format!(
        "notice: LPIPS with {net} is not measured: its weights are not installed, and `genesplat evaluate --help` says \
         which files --install-lpips takes"
    ));
}

/// The tensors of `files` by network; later files win.
pub fn pool(files: &[PathBuf]) -> Result<BTreeMap<Net, NamedTensors>> {
    let mut pool: BTreeMap<Net, NamedTensors> = BTreeMap::new();
    for file in files {
        let (net, tensors) = read(file)?;
        pool.entry(net).or_default().extend(tensors);
    }
    Ok(pool)
}

/// What `file` holds for LPIPS, and for which network.
pub fn read(file: &Path) -> Result<(Net, NamedTensors)> {
    let wanted = |name: &str| Net::ALL.iter().any(|net| net.tensors().any(|(wanted, _)| wanted == name));
    let tensors = read_weights(file, wanted)?;
    let net = Net::ALL.into_iter().find(|&net| belongs_to(net, &tensors));
    net.map(|net| (net, tensors)).ok_or_else(|| {
        anyhow!(
            "{} holds weights of neither VGG16 nor AlexNet as torchvision has them, nor heads of LPIPS 0.1 for them; \
             give other files",
            shown(file)
        )
    })
}

/// `path` itself, or the files in it that could be weights, by name.
fn weight_files(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = fs::read_dir(path)
        .map_err(|error| anyhow!("cannot look for LPIPS weights in {}: {error}", shown(path)))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|file| file.extension().is_some_and(|end| end == "safetensors" || end == "pth"));
    files.sort();
    Ok(files)
}

/// Where installed weights are: below the user's folder for what can be had again, if there is one.
pub fn cache_folder() -> Option<PathBuf> {
    let user = if cfg!(windows) {
        path_in("LOCALAPPDATA")
    } else {
        let below_home = if cfg!(target_os = "macos") { "Library/Caches" } else { ".cache" };
        path_in("HOME").map(|home| home.join(below_home))
    };
    // Explicit everywhere, not only where freedesktop.org's rules hold.
    Some(path_in("XDG_CACHE_HOME").or(user)?.join("genesplat").join("lpips"))
}
