//! What pages are made of. Whatever is spliced into `html!` is escaped, so text cannot become markup.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Inline, so that a page is one file.
const STYLE: PreEscaped<&str> = PreEscaped(include_str!("style.css"));

/// A whole document with this title and body.
pub fn document(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (STYLE) }
            }
            body { main { (body) } }
        }
    };
    page.into_string()
}

/// The figures that matter, large, at the top of a page: name, value, and what else is to be said of it.
pub(crate) fn figures(figures: &[(&str, String, String)]) -> Markup {
    html! {
        dl.figures {
            @for (name, value, more) in figures {
                div { dt { (name) } dd { (value) @if !more.is_empty() { small { (more) } } } }
            }
        }
    }
}

/// A table; the first heading is above the names of the rows.
pub fn table(headings: &[&str], rows: &[(Markup, Vec<String>)]) -> Markup {
    html! {
        figure.table {
            table {
                tr { @for heading in headings { th { (heading) } } }
                @for (name, cells) in rows {
                    tr { th { (name) } @for cell in cells { td { (cell) } } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_values_cannot_become_markup() {
        let text = "<script>alert(\"1 & 2\")</script>";
        let row = (html! { (text) }, vec![text.to_owned()]);
        let figure = (text, text.to_owned(), text.to_owned());
        let page = html! { p title=(text) { (text) } (table(&[text], &[row])) (figures(&[figure])) };
        let page = page.into_string();
        let escaped = "&lt;script&gt;alert(&quot;1 &amp; 2&quot;)&lt;/script&gt;";
        assert_eq!((page.matches(escaped).count(), page.contains("script>")), (8, false), "{page}");
    }

    #[test]
    fn a_document_is_whole_and_loads_nothing() {
        let text = document("<t>", &html! { h1 { "x" } });
        assert!(text.starts_with("<!DOCTYPE html><html") && text.ends_with("</html>"));
        assert!(text.contains("<title>&lt;t&gt;</title>") && text.contains("<h1>x</h1>"));
        let loads = ["http", "src=", "url(", "@import"];
        assert!(loads.iter().all(|load| !text.contains(load)), "{text}");
    }
}
