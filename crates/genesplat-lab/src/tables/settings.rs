//! docs/settings.md: every setting, as the comments in the code explain it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use genesplat::io::{input, shown};
use genesplat::train::{MethodConfig, MethodName};
use toml::{Table, Value};

/// Name of the document in `docs/`.
pub(crate) const NAME: &str = "settings.md";

const HEAD: &str = "# Settings

`genesplat train SCENE --out RUN --config FILE.toml` reads them from a file; flags win over it.
The `config.toml` of a run has its own, and repeats it.
`device` and `threads` say where it computed.

(`cargo run --release -p genesplat-lab -- tables` makes this page of the comments in the code.)
";

/// What stands above the table of the methods' settings.
const METHODS: &str = "
## `[method]`

`name` is the method; default `genesplat`.
Beside it stand settings of that method: those for which its column has a number, which is the default.
`method = \"3dgs\"` alone is the method as published.
";

/// A structure whose fields are settings.
struct Section {
    heading: &'static str,
    /// Below `crates/`.
    file: &'static str,
    /// The line that begins it ends with this.
    start: &'static str,
    /// What its fields have in common.
    words: &'static str,
}

const RUN: Section = Section {
    heading: "Of the whole run",
    file: "genesplat-train/src/config/mod.rs",
    start: "struct TrainConfig {",
    words: "",
};

const METHOD: Section = Section {
    heading: "`[method]`",
    file: "genesplat-train/src/method/settings.rs",
    start: "settings! {",
    words: "",
};

const GENETIC: Section = Section {
    heading: "`[genetic]`",
    file: "genesplat-evolve/src/config.rs",
    start: "struct GeneticConfig {",
    words: "The published search after each opacity reset, where a file has this table; an empty one is Table 1 of the \
            paper.\n",
};

const DATASET: Section = Section {
    heading: "`[dataset]`",
    file: "genesplat-run/src/settings.rs",
    start: "struct Dataset {",
    words: "Where the photos are; `train` writes it, and takes the scene from its arguments.\n",
};

/// The whole page.
pub(crate) fn page(root: &Path) -> Result<String> {
    let parts = [list(root, &RUN)?, methods(root)?, list(root, &GENETIC)?, list(root, &DATASET)?];
    Ok(HEAD.to_owned() + &parts.concat())
}

fn list(root: &Path, section: &Section) -> Result<String> {
    let items = section.fields(root)?.into_iter().map(|(field, text)| format!("- **`{field}`**\n  {text}\n"));
    let (heading, words) = (section.heading, section.words);
    let gap = if words.is_empty() { "" } else { "\n" };
    Ok(format!("\n## {heading}\n\n{words}{gap}{}", items.collect::<String>()))
}

/// A table: a line a setting, a column a method.
fn methods(root: &Path) -> Result<String> {
    let own: Vec<Table> = MethodName::ALL
        .into_iter()
        .map(|name| Table::try_from(MethodConfig::of(name)))
        .collect::<Result<_, _>>()?;
    let names = MethodName::ALL.map(|name| name.name().to_owned());
    let head = row(["setting".to_owned()].into_iter().chain(names).chain(["what".to_owned()]));
    let mut page = format!("{METHODS}\n{head}{}\n", "|---".repeat(MethodName::ALL.len() + 2) + "|");
    for (field, text) in METHOD.fields(root)? {
        let defaults: Vec<String> =
            own.iter().map(|settings| settings.get(&field).map(number).unwrap_or_default()).collect();
        if defaults.iter().all(String::is_empty) {
            bail!("`{field}` is a setting of no method");
        }
        page += &row([format!("`{field}`")].into_iter().chain(defaults).chain([text]));
    }
    Ok(page)
}

fn row(cells: impl Iterator<Item = String>) -> String {
    let cells: Vec<String> = cells.map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// As a file would say it; what was an f32 has that one's digits.
fn number(value: &Value) -> String {
    let Value::Float(float) = *value else { return value.to_string() };
    let single = float as f32;
    let is_small = float != 0.0 && float.abs() < 1e-3;
    match (f64::from(single) == float, is_small) {
        (true, true) => format!("{single:e}"),
        (true, false) => single.to_string(),
        (false, true) => format!("{float:e}"),
        (false, false) => float.to_string(),
    }
}

impl Section {
    /// Names and comments of the fields, but for those that are sections.
    fn fields(&self, root: &Path) -> Result<Vec<(String, String)>> {
        let path = root.join("crates").join(self.file);
        let code = input::read_text(&path).with_context(|| shown(&path).to_string())?;
        fields(&code, self.start).with_context(|| shown(&path).to_string())
    }
}

fn fields(code: &str, start: &str) -> Result<Vec<(String, String)>> {
    let lines = code.lines().skip_while(|line| !line.ends_with(start)).skip(1);
    let (mut fields, mut text) = (Vec::new(), Vec::new());
    for line in lines.map(str::trim).take_while(|line| *line != "}") {
        if let Some(comment) = line.strip_prefix("/// ") {
            text.push(comment);
        } else if let Some((field, kind)) = field(line) {
            let comment = std::mem::take(&mut text).join(" ").replace("[`", "`").replace("`]", "`");
            if kind.contains("Config") {
                continue;
            }
            if comment.is_empty() {
                bail!("`{field}` has no comment");
            }
            fields.push((field.to_owned(), comment));
        }
    }
    if fields.is_empty() {
        bail!("there is no `{start}`");
    }
    Ok(fields)
}

/// Name and type of a field.
fn field(line: &str) -> Option<(&str, &str)> {
    let public = line.strip_prefix("pub(crate) ").or(line.strip_prefix("pub ")).unwrap_or(line);
    public.split_once(": ").filter(|(name, _)| {
        name.bytes().all(|byte| byte.is_ascii_lowercase() || b"_0123456789".contains(&byte))
    })
}
