//! What the command says: results on stdout, errors as one line on stderr.

use std::io::{self, ErrorKind, Write};
use std::panic;

use anyhow::{Result, anyhow};
use genesplat::metrics::Evaluation;

/// Writes `text` and a line break to stdout. A reader that has heard enough (`| head`) is no error.
pub fn print(text: &str) -> Result<()> {
    match writeln!(io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow!("cannot write to stdout: {error}"))
        }
        _ => Ok(()),
    }
}

/// Writes `text` and a line break to stderr. Where that takes nothing (a full disk, a closed pipe) the text is lost: `eprintln!`
/// would panic, and a run must not end because nobody listens.
pub fn tell(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// The means of an evaluation, as a line that starts with `name`.
pub fn scores_line(name: &str, scores: &Evaluation) -> String {
    let Evaluation { psnr, ssim, lpips, views } = scores;
    let lpips = lpips.map_or(String::new(), |lpips| format!("  LPIPS {lpips:.4}"));
    match views.len() {
        0 => format!("{name:<6} no photos"),
        photos => format!("{name:<6} PSNR {psnr:.2} dB  SSIM {ssim:.4}{lpips}  ({photos} photos)"),
    }
}

/// `error` as the one line that scripts may rely on.
///
/// Only the outermost sentence is shown: the typed errors of all crates include their cause in it.
pub fn error_line(error: &anyhow::Error) -> String {
    let sentence = error.to_string();
    format!("error: {}", sentence.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// Replaces the panic message by one that a user can act on.
pub fn explain_panics() {
    panic::set_hook(Box::new(|info| tell(&bug_line(&info.to_string()))));
}

fn bug_line(panic: &str) -> String {
    let detail = panic.split_whitespace().collect::<Vec<_>>().join(" ");
    format!(
        "error: this is a bug in genesplat {}, not a mistake of yours: {detail}; please report this line and the command \
         that you ran to the project's issue tracker",
        env!("CARGO_PKG_VERSION")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_bugs_are_one_line() {
        let error = anyhow!("line 1: unknown field\n  in `evolution`");
        assert_eq!(error_line(&error), "error: line 1: unknown field in `evolution`");
        let bug = bug_line("panicked at src/x.rs:1:2:\nindex out of bounds");
        assert!(bug.lines().count() == 1 && bug.contains("src/x.rs:1:2: index out of bounds"), "{bug}");
    }
}
