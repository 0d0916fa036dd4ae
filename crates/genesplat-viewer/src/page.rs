//! The parts of the page, which are parts of the program.

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// Name, kind, content.
const PARTS: [(&str, &str, &str); 13] = [
    ("", HTML, include_str!("../page/index.html")),
    ("style.css", CSS, include_str!("../page/style.css")),
    ("icon.svg", "image/svg+xml", include_str!("../page/icon.svg")),
    ("main.js", JAVASCRIPT, include_str!("../page/main.js")),
    ("cameras.js", JAVASCRIPT, include_str!("../page/cameras.js")),
    ("charts.js", JAVASCRIPT, include_str!("../page/charts.js")),
    ("connection.js", JAVASCRIPT, include_str!("../page/connection.js")),
    ("edit.js", JAVASCRIPT, include_str!("../page/edit.js")),
    ("navigation.js", JAVASCRIPT, include_str!("../page/navigation.js")),
    ("path.js", JAVASCRIPT, include_str!("../page/path.js")),
    ("stage.js", JAVASCRIPT, include_str!("../page/stage.js")),
    ("status.js", JAVASCRIPT, include_str!("../page/status.js")),
    ("vector.js", JAVASCRIPT, include_str!("../page/vector.js")),
];

/// The kind and the content of a part.
pub(crate) fn part(name: &str) -> Option<(&'static str, &'static str)> {
    PARTS.iter().find(|(part, ..)| *part == name).map(|(_, kind, content)| (*kind, *content))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_loads_nothing_from_elsewhere_and_nothing_that_is_missing() {
        let mut named = 0;
        for (name, _, content) in PARTS {
            let is_name_of_svg = |rest: &str| rest.starts_with("://www.w3.org/2000/svg\"");
            assert!(content.match_indices("://").all(|(at, _)| is_name_of_svg(&content[at..])), "{name}");
            let is_part = |word: &&str| [".js", ".css", ".svg"].iter().any(|end| word.ends_with(end));
            for word in content.split('"').filter(is_part) {
                assert!(part(word.trim_start_matches("./")).is_some(), "{name} names {word}");
                named += 1;
            }
        }
        assert!(named > 10, "{named}");
        assert_eq!(part("../Cargo.toml"), None);
    }
}
