//! `genesplat evaluate --install-lpips`: weights are checked, and put where LPIPS is looked for.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use genesplat::io::shown;
use genesplat::metrics::Lpips;
use genesplat::metrics::weights::{sha256, to_safetensors};
use genesplat::run::{files, lpips};
use genesplat::terminal::output;

/// SHA-256 sums of files that were measured with, and whose figures are those of the authors' own program.
const KNOWN_SUMS: [(&str, &str); 4] = [
    ("137fae61e223a0ffeb6b56e2ef8c925a36a106ef8b15d24a234071617b3ed744", "AlexNet with its heads"),
    ("89514fc74bd0e3652a3974b0f4a34cb01b04c50e5888dd93348cf3f7966862a6", "VGG16 with its heads, in f16"),
    (
        "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
        "the heads for AlexNet of lpips 0.1.4",
    ),
    (
        "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
        "the heads for VGG16 of lpips 0.1.4",
    ),
];

/// Checks everything, then writes: one file a network, in the user's cache folder.
pub(super) fn install(weights: &[PathBuf]) -> Result<()> {
    let Some(folder) = lpips::cache_folder() else {
        bail!("there is no cache folder to install to; set HOME or XDG_CACHE_HOME");
    };
    for file in weights {
        let (net, _) = lpips::read(file)?;
        output::print(&format!("{}: for {net}, {}", shown(file), check_sum(file)?))?;
    }
    let mut pool = lpips::pool(weights)?;
    for (&net, tensors) in &mut pool {
        Lpips::new(net, tensors).map_err(|error| {
            anyhow!("{error}; give both files of {net} at once, torchvision's and the heads of lpips")
        })?;
        let needed: Vec<String> = net.tensors().map(|(name, _)| name).collect();
        tensors.retain(|name, _| needed.contains(name));
    }
    for (net, tensors) in &pool {
        let path = folder.join(format!("lpips_{}.safetensors", net.name()));
        files::write_file(&path, |out| out.write_all(&to_safetensors(tensors)))?;
        output::print(&format!("{net} is installed: {}", shown(path)))?;
    }
    Ok(())
}

/// What the sum of `file` says about it.
fn check_sum(file: &Path) -> Result<String> {
    let sum = sha256(file)?;
    if let Some((_, what)) = KNOWN_SUMS.iter().find(|(known, _)| *known == sum) {
        return Ok(format!("SHA-256 is that of {what}"));
    }
    match promised_sum(file) {
        Some(promised) if sum.starts_with(&promised) => Ok("SHA-256 is as the name promises".into()),
        Some(promised) => bail!(
            "{} is damaged: its name promises a SHA-256 that begins with {promised}, and it is {sum}; download it again",
            shown(file)
        ),
        None => Ok(format!("SHA-256 {sum} is not known here: compare it with where the file is from")),
    }
}

/// torchvision ends a file's name with the first digits of its sum: `vgg16-397923af.pth`.
fn promised_sum(file: &Path) -> Option<String> {
    let digits = file.file_stem()?.to_str()?.rsplit_once('-')?.1;
    let promises = digits.len() == 8 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    promises.then(|| digits.to_ascii_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_promise_a_sum() {
        let promised = |name: &str| promised_sum(Path::new(name));
        assert_eq!(promised("a-b/vgg16-397923af.pth").as_deref(), Some("397923af"));
        assert_eq!(
            (promised("vgg.pth"), promised("my-network.pth"), promised("x-123.pth")),
            (None, None, None)
        );
    }
}
