//! A writer of HTML in which text cannot become markup.
//!
//! Tags and attributes that the program writes itself are given literally (`open("div class=\"wide\"")`); everything else
//! goes through [`Html::text`] or [`Html::attribute_of`], which escape.

/// A page under construction.
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

    /// `</tag>`.
    pub fn close(&mut self, tag: &str) -> &mut Self {
        self.text += &format!("</{tag}>\n");
        self
    }

    /// Text, whatever is in it.
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

    /// What has been written so far.
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
    page.text += &format!("<style>{STYLE}</style>");
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

/// Narrow screens first: wide tables scroll in their own box, figures stand side by side where there is room.
const STYLE: &str = "
:root{color-scheme:light dark;--ink:#1b1f24;--dim:#5b6570;--line:#d5dae0;--paper:#fff;--soft:#f4f6f8;--good:#0b63c5}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ec;--dim:#9aa4ae;--line:#3a424a;--paper:#14181c;--soft:#1e242a;--good:#6cb2ff}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,sans-serif}
main{max-width:1400px;margin:0 auto;padding:1rem}
h1{font-size:1.5rem;line-height:1.25;margin:.5rem 0;overflow-wrap:anywhere}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid var(--line)}
p{margin:.5rem 0;max-width:75ch;overflow-wrap:anywhere}
figure{margin:0}
figcaption,.dim{color:var(--dim);font-size:.875rem;max-width:90ch;overflow-wrap:anywhere}
.table{overflow-x:auto;margin:1rem 0}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.25rem 0}
th,td{padding:.2rem .6rem;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th{font-weight:600}
th:first-child{text-align:left;position:sticky;left:0;background:var(--paper)}
th[colspan]{text-align:center;border-left:1px solid var(--line)}
td small{color:var(--dim)}
.better{color:var(--good);font-weight:600}
.row{display:grid;gap:1rem;grid-template-columns:repeat(auto-fit,minmax(min(100%,20rem),27rem));align-items:start}
.views{display:grid;gap:.5rem;grid-template-columns:repeat(3,1fr);margin:.25rem 0 1rem}
img,svg{display:block;width:100%;height:auto;background:var(--soft)}
.views img{max-height:80vh;object-fit:contain}
svg text{fill:var(--ink);font:11px system-ui,sans-serif}
svg .grid{stroke:var(--line);stroke-width:1}
svg .line{fill:none;stroke-width:1.8;stroke-linejoin:round}
svg .band{stroke:none;opacity:.22}
.legend{display:flex;flex-wrap:wrap;gap:0 1rem;margin:.25rem 0 0;padding:0;list-style:none;font-size:.8125rem}
.legend svg{display:inline-block;width:1.5rem;margin-right:.375rem;background:none;vertical-align:middle}
pre{background:var(--soft);padding:.75rem;overflow-x:auto;font-size:.8125rem;line-height:1.4;margin:.5rem 0}
.command{white-space:pre-wrap;overflow-wrap:anywhere}
a{color:var(--good);overflow-wrap:anywhere}
@media(max-width:600px){
.views{grid-template-columns:1fr}
table{font-size:.8125rem;width:max-content}
th,td{padding:.2rem .3rem}
th:first-child{white-space:normal;max-width:8rem}
}
";

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
        assert!(!text.contains("http") && !text.contains("src=") && !text.contains("@import"), "{text}");
    }
}
