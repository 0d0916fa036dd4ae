//! Where the numbers are crunched.

use anyhow::{Result, anyhow, bail};
use clap::ValueEnum;
use genesplat::kernels::cpu::CpuBackend;
use serde::{Deserialize, Serialize};

use crate::args::MachineArgs;

/// A choice of device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// The best that this build and this machine have.
    #[default]
    Auto,
    /// All cores of the processor.
    Cpu,
    /// A graphics card; this build has no backend for one yet.
    Gpu,
}

impl Device {
    /// The device that is meant, once it is clear that there is one.
    pub fn resolve(self) -> Result<Self> {
        match self {
            Self::Auto | Self::Cpu => Ok(Self::Cpu),
            Self::Gpu => bail!("this build of genesplat has no GPU backend; use --device cpu"),
        }
    }

    /// Says what was chosen for someone who left the choice to us.
    pub fn announce(self) {
        if self == Self::Auto {
            eprintln!("device: auto means the CPU, since this build has no GPU backend");
        }
    }
}

/// An empty backend, for a run with `seed`.
pub fn open(seed: u64) -> CpuBackend {
    CpuBackend::new(seed)
}

/// Makes the machine ready for a command that does not train.
pub fn prepare(args: MachineArgs) -> Result<()> {
    args.device.unwrap_or_default().resolve()?;
    use_threads(args.threads)
}

/// Sets the number of threads of everything that follows; `None` takes all cores.
pub fn use_threads(threads: Option<u16>) -> Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0).into()).build_global().map_err(|error| {
        anyhow!("cannot start {} threads: {error}; use fewer --threads", threads.unwrap_or(0))
    })
}
