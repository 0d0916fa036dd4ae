//! What `experiment/file.rs` takes from the arguments of the command, without the command.

/// Flags that win over an experiment's file.
pub(crate) struct ExperimentArgs {
    pub(crate) size: SizeArgs,
    pub(crate) iterations: Option<u32>,
    pub(crate) steps_scale: Option<f64>,
}

pub(crate) struct SizeArgs {
    pub(crate) max_side: Option<u32>,
    pub(crate) downscale: Option<u32>,
}

impl SizeArgs {
    pub(crate) fn size(&self) -> Option<u32> {
        self.max_side.or(self.downscale)
    }
}
