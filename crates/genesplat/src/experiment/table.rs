//! A table of figures, and the ways to write it: Markdown, LaTeX, HTML.
//!
//! What a figure means is decided once, in the cell ([`Entry`]); the writers only format it.

use crate::report::html::Html;
use crate::terminal::numbers::thousands;

/// A table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub(crate) caption: String,
    /// Columns after the first, which names the rows.
    pub(crate) columns: Vec<Column>,
    /// Name and entries of each row, one entry a column.
    pub(crate) rows: Vec<(String, Vec<Entry>)>,
}

/// A column; neighbours of the same group share a heading.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Column {
    /// Heading above its own; may be empty.
    pub(crate) group: String,
    pub(crate) name: String,
}

/// One cell of a table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Entry {
    Absent,
    Text(String),
    /// A mean and its standard deviation.
    Figure {
        mean: f64,
        /// Unless there is one value only.
        spread: Option<f64>,
        /// After the point.
        digits: usize,
        /// A difference, with a sign; it stands out where it is an improvement.
        gain: bool,
    },
}

impl Entry {
    /// Mean and spread as text, and whether it shows an improvement.
    fn parts(&self) -> (String, Option<String>, bool) {
        match self {
            Self::Absent => ("-".into(), None, false),
            Self::Text(text) => (text.clone(), None, false),
            &Self::Figure { mean, spread, digits, gain } => {
                let shown = match digits {
                    _ if gain => signed(mean, digits),
                    0 => thousands(mean.round() as usize),
                    digits => format!("{mean:.digits$}"),
                };
                let better = gain && shown.starts_with('+');
                (shown, spread.map(|spread| format!("{spread:.digits$}")), better)
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
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let heading = |column: &Column| format!("{} {}", column.group, column.name).trim().to_owned();
        let first = vec![String::new()];
        let mut text = format!("{}\n\n", self.caption);
        text += &line([first, self.columns.iter().map(heading).collect()].concat());
        text += &line(vec!["---".into(); self.columns.len() + 1]);
        for (name, entries) in &self.rows {
            let cells = entries.iter().map(|entry| {
                let (mean, spread, better) = entry.parts();
                let mean = if better { format!("**{mean}**") } else { mean };
                spread.map_or(mean.clone(), |spread| format!("{mean} ± {spread}"))
            });
            let cells = std::iter::once(name.clone()).chain(cells).map(|cell| cell.replace('|', "\\|"));
            text += &line(cells.collect());
        }
        text
    }

    /// As a LaTeX table that needs the packages `booktabs` and `xcolor`; blue where it improves, as in the paper.
    pub(crate) fn to_latex(&self) -> String {
        let group =
            |(name, width): &(&str, usize)| format!("\\multicolumn{{{width}}}{{c}}{{{}}}", latex(name));
        let groups: Vec<String> = self.groups().iter().map(group).collect();
        let names: Vec<String> = self.columns.iter().map(|column| latex(&column.name)).collect();
        let mut lines = vec![
            "\\begin{table}".to_owned(),
            format!("\\caption{{{}}}", latex(&self.caption)),
            format!("\\begin{{tabular}}{{l{}}}", "r".repeat(self.columns.len())),
            "\\toprule".to_owned(),
        ];
        let headings = [groups, names];
        let headings = headings.iter().filter(|row| !row.is_empty());
        lines.extend(headings.map(|row| format!("& {} \\\\", row.join(" & "))));
        lines.push("\\midrule".to_owned());
        for (name, entries) in &self.rows {
            let cells = entries.iter().map(latex_entry).collect::<Vec<_>>().join(" & ");
            lines.push(format!("{} & {cells} \\\\", latex(name)));
        }
        lines.extend(["\\bottomrule", "\\end{tabular}", "\\end{table}", ""].map(str::to_owned));
        lines.join("\n")
    }

    pub(crate) fn write_html(&self, page: &mut Html) {
        page.open("figure class=\"table\"");
        page.element("figcaption", &self.caption);
        page.open("table");
        let groups = self.groups();
        if !groups.is_empty() {
            page.open("tr").element("th", "");
            groups
                .iter()
                .for_each(|(name, width)| _ = page.element(&format!("th colspan=\"{width}\""), name));
            page.close("tr");
        }
        page.open("tr").element("th", "");
        self.columns.iter().for_each(|column| _ = page.element("th", &column.name));
        page.close("tr");
        for (name, entries) in &self.rows {
            page.open("tr").element("th", name);
            for entry in entries {
                let (mean, spread, better) = entry.parts();
                page.open(if better { "td class=\"better\"" } else { "td" }).text(&mean);
                if let Some(spread) = spread {
                    page.element("small", &format!(" ± {spread}"));
                }
                page.close("td");
            }
            page.close("tr");
        }
        page.close("table").close("figure");
    }

    /// Neighbouring columns of the same group: its name and how many there are. Empty where no group has a name.
    fn groups(&self) -> Vec<(&str, usize)> {
        let runs = self.columns.chunk_by(|a, b| a.group == b.group);
        let groups: Vec<_> = runs.map(|run| (run[0].group.as_str(), run.len())).collect();
        if groups.iter().any(|(name, _)| !name.is_empty()) { groups } else { Vec::new() }
    }
}

fn latex_entry(entry: &Entry) -> String {
    let (mean, spread, better) = entry.parts();
    let mean = if matches!(entry, Entry::Figure { .. }) { format!("${mean}$") } else { latex(&mean) };
    let mean = if better { format!("\\textcolor{{blue}}{{{mean}}}") } else { mean };
    spread.map_or(mean.clone(), |spread| format!("{mean} {{\\tiny$\\pm{spread}$}}"))
}

/// `text` with what LaTeX would interpret taken literally.
fn latex(text: &str) -> String {
    let escape = |c: char| match c {
        '&' | '%' | '$' | '#' | '_' | '{' | '}' => format!("\\{c}"),
        '~' => "\\textasciitilde{}".into(),
        '^' => "\\textasciicircum{}".into(),
        '\\' => "\\textbackslash{}".into(),
        '<' => "\\textless{}".into(),
        '>' => "\\textgreater{}".into(),
        // At the start of a row these would be arguments of the line break before it.
        '[' | ']' | '*' => format!("{{{c}}}"),
        'Δ' => "$\\Delta$".into(),
        '±' => "$\\pm$".into(),
        c => c.to_string(),
    };
    text.chars().map(escape).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let column = |group: &str, name: &str| Column { group: group.into(), name: name.into() };
        let figure = |mean, spread, digits, gain| Entry::Figure { mean, spread, digits, gain };
        Table {
            caption: "Test photos.".into(),
            columns: vec![column("3dgs", "PSNR"), column("paper", "ΔP"), column("paper", "ΔS")],
            rows: vec![
                (
                    "a_b".into(),
                    vec![
                        figure(30.125, Some(0.5), 2, false),
                        figure(0.257, Some(0.03), 2, true),
                        Entry::Absent,
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
            text.contains("|  | 3dgs PSNR | paper ΔP | paper ΔS |\n| --- | --- | --- | --- |\n"),
            "{text}"
        );
        assert!(text.contains("| a_b | 30.12 ± 0.50 | **+0.26** ± 0.03 | - |\n"), "{text}");
        // What rounds to nothing has no sign, as in the paper.
        assert!(text.contains("| <i>\\| | 31.00 | 0.00 | -0.1000 |\n"), "{text}");
    }

    #[test]
    fn latex_has_groups_and_takes_names_literally() {
        let text = table().to_latex();
        assert!(text.contains("& \\multicolumn{1}{c}{3dgs} & \\multicolumn{2}{c}{paper} \\\\"), "{text}");
        assert!(text.contains("a\\_b & $30.12$ {\\tiny$\\pm0.50$} & \\textcolor{blue}{$+0.26$}"), "{text}");
        assert!(text.contains("\\textless{}i\\textgreater{}| & $31.00$ & $0.00$ & $-0.1000$ \\\\"), "{text}");
    }

    #[test]
    fn html_escapes_names() {
        let mut page = Html::new();
        table().write_html(&mut page);
        let text = page.into_text();
        assert!(text.contains("<th>&lt;i&gt;|</th>") && !text.contains("<i>"), "{text}");
        assert!(text.contains("<th colspan=\"2\">paper</th>"), "{text}");
        assert!(text.contains("<td class=\"better\">+0.26<small> ± 0.03</small></td>"), "{text}");
    }
}
