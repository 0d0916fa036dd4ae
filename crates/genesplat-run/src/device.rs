//! Where the numbers are crunched: what a user may ask for, and what that comes to on this machine.

use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

use anyhow::{Result, anyhow, bail};
use genesplat_core::{DensitySignal, LearningRates, RenderSettings, StatisticsRequest, TrainStep, Update};
use genesplat_gpu::{AdapterReport, GpuBackend, adapters, check};
use genesplat_kernels::cpu::CpuBackend;
use serde::{Deserialize, Serialize};

use crate::output;

/// What computes.
pub type Device = Box<dyn genesplat_core::Device>;

/// A choice of device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum DeviceChoice {
    /// The graphics card if this machine has one that can be used, else the processor.
    #[default]
    Auto,
    /// All cores of the processor.
    Cpu,
    /// The best graphics device with a Vulkan, Metal or DX12 driver, even one in software.
    Gpu,
    /// The graphics device of this number, as `genesplat devices` counts them.
    GpuAt(u8),
}

/// As flags and files call it.
impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu => f.write_str("gpu"),
            Self::GpuAt(place) => write!(f, "gpu:{place}"),
        }
    }
}

impl From<DeviceChoice> for String {
    fn from(choice: DeviceChoice) -> Self {
        choice.to_string()
    }
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbered = || text.strip_prefix("gpu:")?.parse().ok().map(Self::GpuAt);
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            _ => numbered().ok_or_else(|| {
                format!(
                    "{text} is no device: auto, cpu, gpu or gpu:N, where N is as `genesplat devices` counts"
                )
            }),
        }
    }
}

impl TryFrom<String> for DeviceChoice {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl DeviceChoice {
    /// Whether a graphics device is asked for.
    pub fn is_graphics(self) -> bool {
        matches!(self, Self::Gpu | Self::GpuAt(_))
    }

    /// The place of the graphics device that is asked for; `None` is the best.
    fn place(self) -> Option<usize> {
        if let Self::GpuAt(place) = self { Some(place.into()) } else { None }
    }

    /// Opens the graphics device of this number; the best one where there is none.
    pub fn open_graphics(self) -> Result<GpuBackend> {
        Ok(output::without_drivers(|| GpuBackend::at(self.place()))?)
    }

    /// The device that is meant, never `Auto`; what `Auto` comes to is said once. Asked for once all else is
    /// known to be well: drivers may write to stderr when they are looked for.
    pub fn resolve(self) -> Result<Self> {
        match self {
            Self::Cpu => Ok(Self::Cpu),
            Self::Auto => Ok(if auto_choice().is_ok() { Self::Gpu } else { Self::Cpu }),
            Self::Gpu if graphics().iter().any(|adapter| adapter.unusable.is_none()) => Ok(Self::Gpu),
            Self::Gpu => bail!("{}; use --device cpu", why_none(graphics())),
            Self::GpuAt(place) => usable(place, graphics()).map(|_| self),
        }
    }
}

/// The graphics devices of this machine.
pub fn graphics() -> &'static [AdapterReport] {
    output::without_drivers(adapters)
}

/// The device of this place, if it can be used.
fn usable(place: u8, adapters: &[AdapterReport]) -> Result<&AdapterReport> {
    let adapter = adapters.get(usize::from(place)).ok_or_else(|| {
        anyhow!(
            "there is no graphics device gpu:{place} on this machine; `genesplat devices` lists what there is"
        )
    })?;
    if let Some(reason) = &adapter.unusable {
        bail!(
            "gpu:{place}, {}, cannot be used: it {reason}; choose another of `genesplat devices`",
            adapter.name
        );
    }
    Ok(adapter)
}

/// What `auto` comes to. A driver may refuse what it has promised, so the device is opened once to see.
fn auto_choice() -> &'static Result<(), String> {
    static CHOICE: OnceLock<Result<(), String>> = OnceLock::new();
    CHOICE.get_or_init(|| {
        let opened = || output::without_drivers(|| check(None)).map_err(|error| error.to_string());
        let chosen = auto_adapter(graphics()).and_then(|adapter| opened().map(|()| adapter));
        match &chosen {
            Ok(adapter) => output::note(&format!(
                "notice: {} ({}) does the work; of graphics cards, an NVIDIA H100 has been tried, and --device cpu is what tests run on",
                adapter.name, adapter.api
            )),
            Err(reason) if has_no_card() => {
                output::detail(&format!("the CPU does all the work, since {reason}"));
            }
            Err(reason) => output::note(&cpu_did_all(reason)),
        }
        chosen.map(|_| ())
    })
}

/// Whether this machine has no graphics card, but software or nothing: not worth a word of every command.
fn has_no_card() -> bool {
    graphics().iter().all(AdapterReport::is_software)
}

fn cpu_did_all(reason: &str) -> String {
    format!("notice: the CPU did all the work, since {reason}")
}

/// Says what `auto` has come to on a machine without a card, for who asks for figures.
pub fn notice_no_card(choice: DeviceChoice) {
    if let (DeviceChoice::Auto, true, Err(reason)) = (choice, has_no_card(), auto_choice()) {
        output::note(&cpu_did_all(reason));
    }
}

/// The graphics device that `auto` takes, or why it takes none: one in software is slower than the CPU
/// backend.
fn auto_adapter(adapters: &[AdapterReport]) -> Result<&AdapterReport, String> {
    let usable = || adapters.iter().filter(|adapter| adapter.unusable.is_none());
    match usable().find(|adapter| !adapter.is_software()) {
        Some(adapter) => Ok(adapter),
        None => Err(usable().next().map_or_else(
            || why_none(adapters),
            |software| {
                format!("{} is no graphics card but software, slower than the CPU itself", software.name)
            },
        )),
    }
}

/// Why no graphics device can be used, as the middle of a sentence.
fn why_none(adapters: &[AdapterReport]) -> String {
    let reason = |adapter: &AdapterReport| {
        adapter.unusable.as_ref().map(|reason| format!("{} {reason}", adapter.name))
    };
    let reasons: Vec<String> = adapters.iter().filter_map(reason).collect();
    if reasons.is_empty() {
        return "this machine has no graphics device with a Vulkan, Metal or DX12 driver".into();
    }
    reasons.join("; ")
}

/// Opens the device that is meant.
pub fn open(choice: DeviceChoice) -> Result<Device> {
    match choice.resolve()? {
        device if device.is_graphics() => Ok(Box::new(device.open_graphics()?)),
        _ => Ok(Box::new(CpuBackend::new())),
    }
}

/// A training step that costs what steps cost and changes nothing: its learning rates are zero. `step` counts
/// from 1.
pub fn step_at_rest(view: usize, settings: RenderSettings, step: u32) -> TrainStep {
    let rates = LearningRates {
        position: 0.0,
        // As the default method has it: what is looked for costs as much where nothing is found.
        position_reach: Some(0.1),
        sh_dc: 0.0,
        sh_rest: 0.0,
        opacity: 0.0,
        scale: 0.0,
        rotation: 0.0,
    };
    TrainStep {
        view,
        settings,
        update: Some(Update { rates, step, opacity_step: step, mcmc: None }),
        keeps_gradients: false,
        depth_weight: 0.0,
        statistics: StatisticsRequest { density: Some(DensitySignal::Signed), genes: false },
    }
}

/// Sets the number of threads of everything that follows; `None` takes all cores.
pub fn use_threads(threads: Option<u16>) -> Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0).into()).build_global().map_err(|error| {
        anyhow!(
            "cannot start {}: {error}; use fewer --threads, or raise the limits of this process",
            wanted(threads)
        )
    })
}

fn wanted(threads: Option<u16>) -> String {
    threads.map_or_else(|| "a thread for each core".into(), |threads| format!("{threads} threads"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(name: &str, kind: &'static str, unusable: Option<&str>) -> AdapterReport {
        AdapterReport {
            name: name.into(),
            kind,
            api: "Vulkan".into(),
            driver: String::new(),
            binding_bytes: 1 << 30,
            buffer_bytes: 1 << 30,
            workgroup_bytes: 32 << 10,
            timestamps: true,
            unusable: unusable.map(str::to_owned),
        }
    }

    #[test]
    fn a_device_is_called_as_it_is_written() {
        for text in ["auto", "cpu", "gpu", "gpu:0", "gpu:12"] {
            assert_eq!(text.parse::<DeviceChoice>().map(String::from), Ok(text.to_owned()));
        }
        for wrong in ["", "GPU", "gpu:", "gpu:-1", "gpu:256", "gpu:1:2", "cuda"] {
            assert!(wrong.parse::<DeviceChoice>().unwrap_err().contains("gpu:N"), "{wrong}");
        }
    }

    #[test]
    fn a_device_is_taken_by_its_place() {
        let adapters =
            [adapter("card", "discrete", None), adapter("small", "discrete", Some("has too few bytes"))];
        assert_eq!(usable(0, &adapters).unwrap().name, "card");
        assert!(usable(1, &adapters).unwrap_err().to_string().contains("it has too few bytes"));
        assert!(usable(2, &adapters).unwrap_err().to_string().contains("no graphics device gpu:2"));
    }

    #[test]
    fn auto_takes_a_card_and_no_software() {
        let (card, software) = (adapter("card", "discrete", None), adapter("soft", "software", None));
        let small = adapter("small", "discrete", Some("has too few bytes"));
        let chosen = |adapters: &[AdapterReport]| auto_adapter(adapters).map(|adapter| adapter.name.clone());
        assert_eq!(chosen(&[small.clone(), card, software.clone()]), Ok("card".into()));
        assert!(chosen(&[software]).unwrap_err().contains("soft"));
        assert!(chosen(&[small]).unwrap_err().contains("too few bytes"));
        assert!(chosen(&[]).unwrap_err().contains("no graphics device"));
    }
}
