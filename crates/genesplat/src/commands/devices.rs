//! `genesplat devices`: what this machine can train on.

use anyhow::Result;
use genesplat::core::Backend;

use crate::{device, output};

/// Prints one line a device.
pub fn run() -> Result<()> {
    output::print(&format!("cpu  {}", device::open(0).describe()))?;
    output::print("gpu  none: this build has no GPU backend")
}
