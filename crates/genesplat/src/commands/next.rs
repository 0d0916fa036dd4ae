//! What one does after a command: its last lines on stderr, for who has just done this for the first time.

use std::path::Path;

use genesplat::io::{command_line, shown};
use genesplat::terminal::output;

/// Tells what comes next: commands, each with what it is for.
pub(super) fn tell(steps: &[(&[&str], &str)]) {
    output::tell(&lines(steps));
}

fn lines(steps: &[(&[&str], &str)]) -> String {
    let mut text = String::new();
    for (index, (words, what_for)) in steps.iter().enumerate() {
        let (begin, end) = if index == 0 { ("next   ", "") } else { ("       ", "\n") };
        let command = command_line(["genesplat"].iter().chain(*words).copied());
        text += &format!("{end}{begin}{command}  ({what_for})");
    }
    text
}

/// After a run, or a splat that was made.
pub(super) fn after_splat(splat: &Path) {
    let splat = shown(splat);
    tell(&[
        (&["view", &splat], "look at it in a browser"),
        (&["export", &splat, "--out", "scene.html"], "a page to send"),
    ]);
}

/// After a scene was looked at, or made.
pub(super) fn after_scene(scene: &Path) {
    tell(&[(&["train", &shown(scene), "--out", "RUN", "--view"], "train it, and look at it meanwhile")]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_printed_as_a_shell_takes_them() {
        let text = lines(&[(&["view", "my run"], "look"), (&["export", "a.ply"], "send")]);
        assert_eq!(text, "next   genesplat view 'my run'  (look)\n       genesplat export a.ply  (send)");
    }
}
