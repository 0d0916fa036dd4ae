//! `genesplat split` and `genesplat merge`.

use std::path::PathBuf;

use clap::Args;

use super::{HoldOutArgs, fraction};

#[derive(Debug, Args)]
pub(crate) struct SplitArgs {
    /// Folder of the scene
    #[arg(value_name = "DATASET")]
    pub(crate) data: PathBuf,
    /// Blocks along the longer and along the shorter side of the ground
    #[arg(long, value_name = "AxB", value_parser = blocks)]
    pub(crate) blocks: Blocks,
    /// What stands so near to a block counts as its own when its photos are chosen: a fraction of the block's
    /// sides
    #[arg(long, value_name = "FRACTION", value_parser = fraction::<f64>, default_value = "0.1")]
    pub(crate) margin: f64,
    /// Folder for the blocks, which must not be there yet or be empty
    #[arg(long, value_name = "BLOCKS")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) hold_out: HoldOutArgs,
}

#[derive(Debug, Args)]
pub(crate) struct MergeArgs {
    /// Folder of the blocks, all of them trained
    #[arg(value_name = "BLOCKS")]
    pub(crate) blocks: PathBuf,
    /// The splat to write, in the format that its name ends in (.ply, .compressed.ply, .splat, .spz, .sog or
    /// .glb)
    #[arg(long, value_name = "OUT.ply")]
    pub(crate) out: PathBuf,
}

/// Columns and rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Blocks(pub(crate) [usize; 2]);

/// Most blocks along a side.
const SIDE_MAX: usize = 100;

fn blocks(text: &str) -> Result<Blocks, String> {
    let numbers: Option<Vec<usize>> = text.split('x').map(|word| word.parse().ok()).collect();
    let sides = numbers.as_deref().and_then(|numbers| <[usize; 2]>::try_from(numbers).ok());
    let is_valid = |sides: &[usize; 2]| sides.iter().all(|side| (1..=SIDE_MAX).contains(side));
    sides
        .filter(is_valid)
        .map(Blocks)
        .ok_or_else(|| format!("two numbers from 1 to {SIDE_MAX} with an x between them are needed, as 2x1"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_two_numbers() {
        assert_eq!(blocks("2x1"), Ok(Blocks([2, 1])));
        for wrong in ["", "2", "2x", "0x1", "2x1x1", "101x1", "-1x1"] {
            assert!(blocks(wrong).is_err(), "{wrong}");
        }
    }
}
