//! A writer of HTML in which text cannot become markup.
//!
//! Tags and attributes that the program writes itself are given literally; everything else is escaped.

/// HTML that is being written.
#[derive(Clone, Debug, Default)]
pub struct Html {
    text: String,
}

impl Html {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// `<tag>`; `tag` may hold attributes that the program knows.
    pub fn open(&mut self, tag: &str) -> &mut Self {
        self.text += &format!("<{tag}>");
        self
    }

    /// The same with an attribute whose value comes from elsewhere.
    pub fn attribute_of(&mut self, tag: &str, attribute: &str, value: &str) -> &mut Self {
        self.text += &format!("<{tag} {attribute}=\"{}\">", escape(value));
        self
    }

    /// The end of an element.
    pub fn close(&mut self, tag: &str) -> &mut Self {
        self.text += &format!("</{tag}>\n");
        self
    }

    /// Text, escaped.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.text += &escape(text);
        self
    }

    /// `<tag>text</tag>`; `tag` may hold attributes that the program knows.
    pub fn element(&mut self, tag: &str, text: &str) -> &mut Self {
        let name = tag.split(' ').next().unwrap_or(tag);
        self.open(tag).text(text).close_inline(name)
    }

    fn close_inline(&mut self, name: &str) -> &mut Self {
        self.text += &format!("</{name}>");
        self
    }

    /// The row of headings of a table; the first one is above the names of the rows.
    pub fn headings(&mut self, names: &[&str]) -> &mut Self {
        self.open("tr");
        names.iter().for_each(|name| _ = self.element("th", name));
        self.close("tr")
    }

    /// A row of a table.
    pub fn row(&mut self, name: &str, cells: &[String]) -> &mut Self {
        self.open("tr").element("th", name);
        cells.iter().for_each(|cell| _ = self.element("td", cell));
        self.close("tr")
    }

    /// The figures that matter, large, at the top of a page: name, value, and what else is to be said of it.
    pub fn figures(&mut self, figures: &[(&str, String, String)]) -> &mut Self {
        self.open("dl class=\"figures\"");
        for (name, value, more) in figures {
            self.open("div").element("dt", name).open("dd").text(value);
            if !more.is_empty() {
                self.element("small", more);
            }
            self.close("dd").close("div");
        }
        self.close("dl")
    }

    /// The markup.
    pub fn into_text(self) -> String {
        self.text
    }
}

/// A whole document with this title and body.
pub fn document(title: &str, body: Html) -> String {
    let mut page = Html::new();
    page.open("!doctype html").open("html lang=\"en\"").open("head").open("meta charset=\"utf-8\"");
    page.open("meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"");
    page.element("title", title);
    page.text += &format!("<style>\n{STYLE}</style>\n");
    page.close("head").open("body").open("main");
    page.text += &body.text;
    page.close("main").close("body").close("html");
    page.into_text()
}

/// `text` with the five characters escaped that mean something in HTML.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            '\'' => escaped += "&#39;",
            c => escaped.push(c),
        }
    }
    escaped
}

/// Inline, so that a page is one file.
const STYLE: &str = include_str!("style.css");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_values_cannot_become_markup() {
        let mut page = Html::new();
        page.element("p class=\"dim\"", "<script>alert('1 & 2')</script>");
        page.attribute_of("img", "alt", "\" onload=\"x");
        assert_eq!(
            page.into_text(),
            "<p class=\"dim\">&lt;script&gt;alert(&#39;1 &amp; 2&#39;)&lt;/script&gt;</p>\
             <img alt=\"&quot; onload=&quot;x\">"
        );
    }

    #[test]
    fn a_document_is_whole_and_loads_nothing() {
        let mut body = Html::new();
        body.element("h1", "x");
        let text = document("<t>", body);
        assert!(text.starts_with("<!doctype html>") && text.trim_end().ends_with("</html>"));
        assert!(text.contains("<title>&lt;t&gt;</title>") && text.contains("<h1>x</h1>"));
        let loads = ["http", "src=", "url(", "@import"];
        assert!(loads.iter().all(|load| !text.contains(load)), "{text}");
    }
}
