//! docs/settings.md: every setting, as the comments in the code explain it.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

/// Name of the document in `docs/`.
pub(crate) const NAME: &str = "settings.md";

const HEAD: &str = "# Settings

`genesplat train SCENE --out RUN --config FILE.toml` reads them from a file; flags win over it.
The `config.toml` of a run has its own, and repeats it.
A setting that it does not have has the default of its method.
`device` and `threads` say where it computed.

(`cargo run --release -p genesplat-lab -- tables` makes this page of the comments in the code.)
";

/// Section, file below `crates/`, structure.
const SECTIONS: [(&str, &str, &str); 8] = [
    ("", "genesplat-train/src/config/mod.rs", "TrainConfig"),
    ("optimiser", "genesplat-train/src/config/mod.rs", "OptimiserConfig"),
    ("densify", "genesplat-train/src/config/density.rs", "DensifyConfig"),
    ("mcmc", "genesplat-train/src/config/density.rs", "McmcConfig"),
    ("evolution", "genesplat-train/src/config/evolution.rs", "EvolutionConfig"),
    ("evolution.renewal", "genesplat-train/src/config/evolution.rs", "RenewalConfig"),
    ("evolution.paper", "genesplat-evolve/src/config.rs", "PaperConfig"),
    ("dataset", "genesplat-run/src/settings.rs", "Dataset"),
];

/// The whole page.
pub(crate) fn page(root: &Path) -> Result<String> {
    let mut page = HEAD.to_owned();
    for (section, file, name) in SECTIONS {
        let path = root.join("crates").join(file);
        let code = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let fields = fields(&code, name).with_context(|| path.display().to_string())?;
        if section.is_empty() {
            page += "\n## Of the whole run\n\n";
        } else {
            page += &format!("\n## `[{section}]`\n\n");
        }
        for (field, text) in fields {
            page += &format!("- **`{field}`**\n  {text}\n");
        }
    }
    Ok(page)
}

/// Names and comments of the fields of a structure, but for those that are sections.
fn fields(code: &str, name: &str) -> Result<Vec<(String, String)>> {
    let start = code.lines().skip_while(|line| !line.ends_with(&format!("struct {name} {{"))).skip(1);
    let (mut fields, mut text) = (Vec::new(), Vec::new());
    for line in start.map(str::trim).take_while(|line| *line != "}") {
        if let Some(comment) = line.strip_prefix("/// ") {
            text.push(comment);
        } else if let Some((field, kind)) = field(line) {
            let comment = std::mem::take(&mut text).join(" ").replace("[`", "`").replace("`]", "`");
            if kind.ends_with("Config,") {
                continue;
            }
            if comment.is_empty() {
                bail!("{name}::{field} has no comment");
            }
            fields.push((field.to_owned(), comment));
        }
    }
    if fields.is_empty() {
        bail!("there is no structure {name}");
    }
    Ok(fields)
}

/// Name and type of a field.
fn field(line: &str) -> Option<(&str, &str)> {
    let public = line.strip_prefix("pub(crate) ").or(line.strip_prefix("pub "))?;
    public.split_once(": ")
}
