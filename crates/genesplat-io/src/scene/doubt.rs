//! Why to train on a scene makes no sense.

use std::fmt;

/// What is known before the first step, and that no step mends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Doubt {
    /// One sentence, without its end.
    pub problem: String,
    /// What to do.
    pub remedy: String,
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.problem, self.remedy)
    }
}
