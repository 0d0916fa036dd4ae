//! A table of figures, as Markdown and as HTML.
//!
//! What a figure means is decided once, in the cell ([`Entry`]); the writers only format it.

use genesplat::run::numbers::thousands;
use maud::{Markup, Render, html};

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub(crate) caption: String,
    /// Headings of the columns after the first, which names the rows.
    pub(crate) columns: Vec<String>,
    /// Name and entries of each row, one entry a column.
    pub(crate) rows: Vec<(String, Vec<Entry>)>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Entry {
    Text(String),
    /// A mean and its standard deviation, unless there is one value only.
    Figure {
        mean: f64,
        spread: Option<f64>,
        digits: usize,
        /// A difference, with a sign; it stands out where it is an improvement.
        gain: bool,
    },
}

impl Entry {
    /// What was not measured.
    pub(crate) fn absent() -> Self {
        Self::Text("-".into())
    }

    /// Mean and spread as text, and whether it shows an improvement.
    fn parts(&self) -> (String, String, bool) {
        match self {
            Self::Text(text) => (text.clone(), String::new(), false),
            &Self::Figure { mean, spread, digits, gain } => {
                let shown = match digits {
                    _ if gain => signed(mean, digits),
                    0 => thousands(mean.round() as usize),
                    digits => format!("{mean:.digits$}"),
                };
                let better = gain && shown.starts_with('+');
                (shown, spread.map_or(String::new(), |spread| format!(" ± {spread:.digits$}")), better)
            }
        }
    }
}

/// With a sign unless it is zero at this many digits, as the paper prints differences.
fn signed(value: f64, digits: usize) -> String {
    let text = format!("{value:+.digits$}");
    let is_zero = text.chars().all(|c| "+-0.".contains(c));
    if is_zero { text[1..].to_owned() } else { text }
}

impl Table {
    /// As Markdown, bold where it improves.
    pub(crate) fn to_markdown(&self) -> String {
        let line = |name: &str, cells: Vec<String>| {
            let cells: Vec<String> =
                cells.iter().map(|cell| format!(" {} |", cell.replace('|', "\\|"))).collect();
            format!("| {} |{}\n", name.replace('|', "\\|"), cells.concat())
        };
        let mut text = format!("{}\n\n", self.caption);
        text += &line("", self.columns.clone());
        text += &line("---", vec!["---".into(); self.columns.len()]);
        for (name, entries) in &self.rows {
            let cells = entries.iter().map(|entry| match entry.parts() {
                (mean, spread, true) => format!("**{mean}**{spread}"),
                (mean, spread, false) => mean + &spread,
            });
            text += &line(name, cells.collect());
        }
        text
    }
}

impl Render for Table {
    fn render(&self) -> Markup {
        html! {
            figure.table {
                figcaption { (self.caption) }
                table {
                    tr { th {} @for column in &self.columns { th { (column) } } }
                    @for (name, entries) in &self.rows {
                        tr { th { (name) } @for entry in entries { (entry) } }
                    }
                }
            }
        }
    }
}

impl Render for Entry {
    fn render(&self) -> Markup {
        let (mean, spread, better) = self.parts();
        html! { td.better[better] { (mean) @if !spread.is_empty() { small { (spread) } } } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let figure = |mean, spread, digits, gain| Entry::Figure { mean, spread, digits, gain };
        Table {
            caption: "Test photos.".into(),
            columns: ["3dgs PSNR", "genetic ΔP", "genetic ΔS"].map(str::to_owned).into(),
            rows: vec![
                (
                    "a_b".into(),
                    vec![
                        figure(30.125, Some(0.5), 2, false),
                        figure(0.257, Some(0.03), 2, true),
                        Entry::absent(),
                    ],
                ),
                (
                    "<i>|".into(),
                    vec![
                        figure(31.0, None, 2, false),
                        figure(-0.004, None, 2, true),
                        figure(-0.1, None, 4, true),
                    ],
                ),
            ],
        }
    }

    #[test]
    fn markdown_is_a_table_with_improvements_in_bold() {
        let text = table().to_markdown();
        assert!(
            text.contains("|  | 3dgs PSNR | genetic ΔP | genetic ΔS |\n| --- | --- | --- | --- |\n"),
            "{text}"
        );
        assert!(text.contains("| a_b | 30.12 ± 0.50 | **+0.26** ± 0.03 | - |\n"), "{text}");
        // What rounds to nothing has no sign, as in the paper.
        assert!(text.contains("| <i>\\| | 31.00 | 0.00 | -0.1000 |\n"), "{text}");
    }

    #[test]
    fn html_escapes_names() {
        let text = table().render().into_string();
        assert!(text.contains("<th>&lt;i&gt;|</th>") && !text.contains("<i>"), "{text}");
        assert!(text.contains("<th>genetic ΔP</th>"), "{text}");
        assert!(text.contains("<td class=\"better\">+0.26<small> ± 0.03</small></td>"), "{text}");
    }
}
