//! Loops of constant length, written out.
//!
//! naga gives every loop a counter of its own, so that a wrong bound cannot hang a device. That counter hides
//! from NVIDIA's compiler that a loop is eight steps long: it is not unrolled, and an array that is indexed
//! by the step becomes a chain of comparisons. `lab/performance.md` has what that cost. So a loop that counts
//! by constants is written out when a shader is put together: each step is a block that begins with the value
//! of the variable, as a constant. The files stay ordinary WGSL, and nothing is trusted that was checked
//! before.

/// Steps of the longest loop that is written out.
const STEPS_MAX: usize = 32;

/// The same shader without comments, and without loops whose header is made of constants. What has no
/// constant header, too many steps, or a `break` or `continue` of any loop in it, stays a loop.
pub(crate) fn unrolled(source: &str) -> String {
    let lines: Vec<&str> =
        source.lines().map(|line| line.split("//").next().unwrap_or(line).trim_end()).collect();
    let source = lines.join("\n");
    unrolled_part(&source, &source)
}

/// A part of a shader; constants are looked up in all of it.
fn unrolled_part(part: &str, shader: &str) -> String {
    let Some((before, header, body, after)) = first_loop(part) else { return part.to_owned() };
    let body = unrolled_part(body, shader);
    let after = unrolled_part(after, shader);
    match Count::parse(header, shader).filter(|_| !leaves_early(&body)) {
        Some(Count { variable, values }) => {
            let steps: String = values
                .iter()
                .map(|value| format!("{{ const {variable}: u32 = {value}u; {body}}}\n"))
                .collect();
            format!("{before}{steps}{after}")
        }
        None => format!("{before}for ({header}) {{{body}}}{after}"),
    }
}

/// The text before the first `for`, its header and body without brackets, and the text after it.
fn first_loop(text: &str) -> Option<(&str, &str, &str, &str)> {
    let (before, rest) = text.split_once("for (")?;
    let (header, rest) = split_at_closing(rest, '(', ')')?;
    let (body, after) = split_at_closing(rest.trim_start().strip_prefix('{')?, '{', '}')?;
    Some((before, header, body, after))
}

/// What comes before and after the bracket that closes one which is open at the beginning.
fn split_at_closing(text: &str, open: char, close: char) -> Option<(&str, &str)> {
    let mut depth = 1;
    for (at, character) in text.char_indices() {
        depth += i32::from(character == open) - i32::from(character == close);
        if depth == 0 {
            return Some((&text[..at], &text[at + close.len_utf8()..]));
        }
    }
    None
}

fn leaves_early(body: &str) -> bool {
    words(body).any(|word| word == "break" || word == "continue")
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_')
}

/// A loop that counts by constants.
#[derive(Debug, PartialEq)]
struct Count<'a> {
    variable: &'a str,
    values: Vec<u32>,
}

impl<'a> Count<'a> {
    /// From `var i = FIRST; i < END; i += STEP`, or with `>`, `++`, `*=` or `/=`; `None` for anything else.
    fn parse(header: &'a str, shader: &str) -> Option<Self> {
        let mut parts = header.split(';').map(str::trim);
        let (first, condition, step) = (parts.next()?, parts.next()?, parts.next()?);
        let (variable, first) = first.strip_prefix("var ")?.split_once('=')?;
        let variable = variable.trim();
        let condition = condition.strip_prefix(variable)?.trim_start();
        let step = step.strip_prefix(variable)?.trim_start();
        let (rises, end) = match condition.strip_prefix('<') {
            Some(end) => (true, end),
            None => (false, condition.strip_prefix('>')?),
        };
        let (operator, amount) =
            if step == "++" { ("+=", 1) } else { (step.get(..2)?, value(&step[2..], shader)?) };
        let end = value(end, shader)?;
        let mut values = Vec::new();
        let mut at = value(first, shader)?;
        while if rises { at < end } else { at > end } {
            values.push(at);
            if values.len() > STEPS_MAX {
                return None;
            }
            at = match operator {
                "+=" => at.checked_add(amount)?,
                "*=" => at.checked_mul(amount)?,
                "/=" => at.checked_div(amount)?,
                _ => return None,
            };
        }
        Some(Self { variable, values })
    }
}

/// The value of an expression of u32 literals and constants, with `+`, `-`, `*` and `/` and without brackets.
fn value(expression: &str, shader: &str) -> Option<u32> {
    // The last operator of the lowest rank is applied last.
    let at = expression.rfind(['+', '-']).or_else(|| expression.rfind(['*', '/']));
    let Some(at) = at else { return term(expression.trim(), shader) };
    let (left, right) = (value(&expression[..at], shader)?, value(&expression[at + 1..], shader)?);
    match expression.as_bytes()[at] {
        b'+' => left.checked_add(right),
        b'-' => left.checked_sub(right),
        b'*' => left.checked_mul(right),
        _ => left.checked_div(right),
    }
}

/// A literal, or a constant of the shader.
fn term(term: &str, shader: &str) -> Option<u32> {
    let is_name = term.starts_with(|c: char| c.is_ascii_uppercase());
    if !is_name {
        return term.strip_suffix('u')?.parse().ok();
    }
    let (_, after) = shader.split_once(&format!("const {term}: u32 = "))?;
    value(after.split_once(';')?.0, shader)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "const TILE: u32 = 16u;\nconst PARTS: u32 = TILE * 2u / 4u;\n";

    fn values(header: &str) -> Option<Vec<u32>> {
        Count::parse(header, HEAD).map(|count| count.values)
    }

    #[test]
    fn a_header_of_constants_is_counted() {
        assert_eq!(values("var i = 0u; i < 3u; i++"), Some(vec![0, 1, 2]));
        assert_eq!(values("var part = 1u; part < PARTS + 2u; part += 4u"), Some(vec![1, 5, 9]));
        assert_eq!(values("var bit = 1u; bit < TILE; bit *= 2u"), Some(vec![1, 2, 4, 8]));
        assert_eq!(values("var half = PARTS / 2u; half > 0u; half /= 2u"), Some(vec![4, 2, 1]));
        assert_eq!(values("var i = 0u; i < 2u * TILE - 1u - 29u; i++"), Some(vec![0, 1]), "from the left");
        assert_eq!(values("var i = 0u; i < 0u; i++"), Some(vec![]));
    }

    #[test]
    fn what_depends_on_data_or_is_long_stays_a_loop() {
        for header in [
            "var i = 0u; i < count; i++",
            "var at = lane; at < TILE; at += 2u",
            "; at < TILE; at++",
            "var i = 0u; i < UNKNOWN; i++",
            "var i = 0u; i < TILE && !done; i++",
            "var i = 0u; i < 33u; i++",
            "var i = 0u; i < 2u; i += 0u",
            "var i = 0u; i < 2u; i -= 1u",
        ] {
            assert_eq!(values(header), None, "{header}");
        }
    }

    #[test]
    fn loops_in_loops_are_written_out() {
        let source = "for (var i = 0u; i < 2u; i++) {\n    for (var k = 0u; k < i; k++) { f(k); } // a comment {\n    \
                      for (var k = 2u; k < 4u; k++) { g(i, k); }\n}\nh();";
        let text = unrolled(source);
        let steps =
            ["const i: u32 = 0u;", "const i: u32 = 1u;", "h();"].map(|step| text.find(step).expect(step));
        assert!(steps.is_sorted());
        assert_eq!(text.matches("g(i, k);").count(), 4);
        assert_eq!(text.matches("for (var k = 0u; k < i; k++) { f(k); }").count(), 2, "{text}");
        assert!(!text.contains("comment"));
    }

    #[test]
    fn a_loop_that_is_left_early_stays() {
        let source = "for (var i = 0u; i < 2u; i++) { if done { break; } }";
        assert_eq!(unrolled(source), source);
        assert_ne!(unrolled(&source.replace("break", "breaker()")), source);
    }
}
