//! An open device: compiled kernels, submissions and waits.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use genesplat_core::BackendError;
use wgpu::{
    Adapter, BindGroupLayout, Buffer, CommandBuffer, ComputePipeline, ComputePipelineDescriptor, Device,
    DeviceDescriptor, DeviceType, Features, Limits, PipelineCompilationOptions, PollError, PollType, Queue,
    ShaderModuleDescriptor, ShaderSource, SubmissionIndex,
};

use crate::Result;
use crate::device::MemoryUse;
use crate::device::adapter::{self, WORKGROUP_BYTES};
#[cfg(test)]
use crate::device::shaders::kernel_texts;
use crate::device::shaders::{Abilities, Shader};
use crate::layout::SH_FLOATS;

/// Views that may be submitted without a wait.
const QUEUED_VIEWS_MAX: usize = 32;

/// Longest time that a device may take for all that was submitted: a driver that hangs would keep the host
/// forever. Software drivers are slow, and 32 steps may be in the queue.
const WAIT_MAX: Duration = Duration::from_secs(600);

/// Instructions, of all invocations together, that a submission is to take at most: half a second of a weak
/// device, by the kind that it is. If they reach a fifth of their peaks, integrated ones of 0.4 TFLOPS make
/// 40 G a second, and discrete ones of 2.5 TFLOPS 250 G.
const INTEGRATED_INSTRUCTIONS: u64 = 1 << 34;
const DISCRETE_INSTRUCTIONS: u64 = 1 << 37;

/// wgpu tells Metal's kernels how long a binding is in 32 bits, whatever limit it reports: they would see no
/// more. A multiple of what bindings begin at.
const BINDING_BYTES_MAX: u64 = !255u32 as u64;

pub(super) type KernelKey = (&'static str, Vec<(&'static str, u32)>);

/// What a test makes of the text of a kernel of this name, with its loops.
#[cfg(test)]
pub(crate) type Rewrite = Box<dyn Fn(&str, String) -> String>;

/// A compiled shader, and how its buffers are bound.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pub(crate) pipeline: ComputePipeline,
    pub(crate) layout: BindGroupLayout,
}

pub(crate) struct Engine {
    pub(crate) device: Device,
    pub(crate) queue: Queue,
    /// Runs on the processor.
    #[cfg(test)]
    pub(crate) is_software: bool,
    /// Name and programming interface, for the log.
    pub(crate) name: String,
    /// Largest part of a buffer that a kernel can see, bytes.
    pub(crate) binding_bytes: u64,
    pub(super) buffer_bytes: u64,
    /// Rows of the cloud that a kernel can see at once.
    pub(crate) window_rows: u64,
    /// Instructions that a submission is to take at most.
    pub(crate) instructions_max: u64,
    /// The device can time passes.
    pub(crate) timestamps: bool,
    pub(crate) abilities: Abilities,
    pub(crate) usage: MemoryUse,
    /// How often the host has waited for all that was submitted, has submitted and has asked for a kernel to
    /// run, and bytes that it has read back: what tests count.
    pub(crate) waits: Cell<u32>,
    pub(crate) submissions: Cell<u32>,
    pub(crate) dispatches: Cell<u32>,
    pub(crate) read_bytes: Cell<u64>,
    kernels: RefCell<HashMap<KernelKey, Kernel>>,
    failures: Arc<Failures>,
    /// What small answers are read through.
    pub(super) staging: OnceCell<Buffer>,
    #[cfg(test)]
    rewrite: Option<Rewrite>,
}

/// What a device reports between calls: the first message of each kind stays.
#[derive(Default)]
struct Failures {
    /// Why it stopped working.
    lost: OnceLock<String>,
    /// What it found wrong with a command: it goes on working, but what the command was for is not done.
    refused: OnceLock<String>,
}

impl Engine {
    /// The device of this place, or the best.
    pub(crate) fn at(place: Option<usize>) -> Result<Self> {
        Self::open(adapter::chosen(place)?, WORKGROUP_BYTES)
    }

    /// A device, with workgroup memory of so many bytes if it has them.
    pub(crate) fn open(adapter: &Adapter, most_workgroup_bytes: u32) -> Result<Self> {
        let info = adapter.get_info();
        let name = format!("{} ({:?})", info.name, info.backend);
        let features = adapter.features() & Features::TIMESTAMP_QUERY;
        let workgroup_bytes = adapter.limits().max_compute_workgroup_storage_size.min(most_workgroup_bytes);
        let descriptor = DeviceDescriptor {
            label: Some("genesplat"),
            required_features: features,
            // No more of what kernels use than they need, so that one that needs more fails everywhere.
            required_limits: Limits {
                max_compute_workgroup_storage_size: workgroup_bytes,
                max_storage_buffers_per_shader_stage: adapter::STORAGE_BUFFERS,
                ..adapter.limits()
            },
            ..DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| BackendError::Unsupported(format!("{name} cannot be opened: {error}")))?;
        let limits = device.limits();
        let binding_bytes = limits.max_storage_buffer_binding_size.min(BINDING_BYTES_MAX);
        Ok(Self {
            binding_bytes,
            buffer_bytes: limits.max_buffer_size,
            window_rows: binding_bytes / (4 * u64::from(SH_FLOATS)),
            instructions_max: match info.device_type {
                DeviceType::DiscreteGpu => DISCRETE_INSTRUCTIONS,
                _ => INTEGRATED_INSTRUCTIONS,
            },
            failures: watch(&device),
            #[cfg(test)]
            is_software: info.device_type == DeviceType::Cpu,
            device,
            queue,
            name,
            timestamps: features.contains(Features::TIMESTAMP_QUERY),
            abilities: Abilities { workgroup_bytes },
            usage: MemoryUse::default(),
            waits: Cell::default(),
            submissions: Cell::default(),
            dispatches: Cell::default(),
            read_bytes: Cell::default(),
            kernels: RefCell::default(),
            staging: OnceCell::new(),
            #[cfg(test)]
            rewrite: None,
        })
    }

    /// The same, but kernels see at most `rows` rows of the cloud at once: how tests exercise the splitting
    /// of columns.
    #[cfg(test)]
    pub(crate) fn with_window_rows(mut self, rows: u64) -> Self {
        self.window_rows = self.window_rows.min(rows);
        self
    }

    /// The same, but a submission takes at most so many instructions: how tests exercise its splitting.
    #[cfg(test)]
    pub(crate) fn with_instructions(mut self, most: u64) -> Self {
        self.instructions_max = most;
        self
    }

    /// From now on kernels are what `rewrite` makes of them; those that it leaves as they were are not
    /// compiled anew.
    #[cfg(test)]
    pub(crate) fn set_rewrite(&mut self, rewrite: Rewrite) {
        let text = |rewrite: Option<&Rewrite>, name| {
            let (_, text) = kernel_texts(self.abilities).find(|(kernel, _)| *kernel == name)?;
            Some(rewrite?(name, text))
        };
        let before = self.rewrite.replace(rewrite);
        self.usage.bound.forget();
        let now = self.rewrite.as_ref();
        self.kernels.borrow_mut().retain(|(name, _), _| text(before.as_ref(), name) == text(now, name));
    }

    fn source(&self, shader: &'static Shader) -> String {
        #[cfg(test)]
        if let Some(rewrite) = &self.rewrite {
            return rewrite(shader.name, shader.text(self.abilities));
        }
        shader.source(self.abilities)
    }

    /// Hands commands to the device, and before them all that was written; does not wait.
    pub(crate) fn submit(&self, commands: impl IntoIterator<Item = CommandBuffer>) -> SubmissionIndex {
        self.usage.written.set(0);
        self.submissions.set(self.submissions.get() + 1);
        self.queue.submit(commands)
    }

    /// Waits until everything submitted is done; only then is the memory of dropped buffers free.
    pub(crate) fn wait(&self) -> Result<()> {
        self.waits.set(self.waits.get() + 1);
        self.wait_for(None)
    }

    /// The same for what was submitted up to here, if that is said: the device may go on with what came
    /// later.
    pub(super) fn wait_for(&self, submission_index: Option<SubmissionIndex>) -> Result<()> {
        match self.device.poll(PollType::Wait { submission_index, timeout: Some(WAIT_MAX) }) {
            Ok(_) => self.check(),
            Err(PollError::Timeout) => {
                Err(self.is_lost(&format!("it has not answered for {} s", WAIT_MAX.as_secs())))
            }
            Err(error) => Err(self.is_lost(&error.to_string())),
        }
    }

    /// Waits after every few of many views that are submitted, `view` of them before this one: a slow device
    /// never has to answer for hundreds at once, which would look as if it were lost.
    pub(crate) fn pace(&self, view: usize) -> Result<()> {
        if view > 0 && view.is_multiple_of(QUEUED_VIEWS_MAX) { self.wait() } else { Ok(()) }
    }

    /// An error if the device is lost or has refused something; what is lost refuses everything.
    pub(crate) fn check(&self) -> Result<()> {
        let Failures { lost, refused } = &*self.failures;
        match (lost.get(), refused.get()) {
            (Some(reason), _) => Err(self.is_lost(reason)),
            (None, Some(reason)) => Err(BackendError::Unsupported(format!(
                "{} refused a command: {}; this is an error in genesplat or in the driver, use --device cpu",
                self.name,
                reason.replace('\n', " ")
            ))),
            (None, None) => Ok(()),
        }
    }

    pub(super) fn is_lost(&self, reason: &str) -> BackendError {
        BackendError::DeviceLost { device: self.name.clone(), reason: reason.replace('\n', " ") }
    }

    /// A compiled kernel; compiled when it is first asked for.
    pub(crate) fn kernel(&self, shader: &'static Shader, overrides: &[(&'static str, u32)]) -> Kernel {
        let key = (shader.name, overrides.to_vec());
        if let Some(kernel) = self.kernels.borrow().get(&key) {
            return kernel.clone();
        }
        let module = self.device.create_shader_module(ShaderModuleDescriptor {
            label: Some(shader.name),
            source: ShaderSource::Wgsl(self.source(shader).into()),
        });
        let constants: Vec<(&str, f64)> =
            overrides.iter().map(|&(name, value)| (name, value.into())).collect();
        let pipeline = self.device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some(shader.name),
            layout: None,
            module: &module,
            entry_point: Some("main"),
            // Every kernel writes its workgroup memory before it reads it.
            compilation_options: PipelineCompilationOptions {
                constants: &constants,
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        let kernel = Kernel { layout: pipeline.get_bind_group_layout(0), pipeline };
        self.kernels.borrow_mut().insert(key, kernel.clone());
        kernel
    }
}

/// Where the device notes why it was lost, and what it has refused.
fn watch(device: &Device) -> Arc<Failures> {
    let failures = Arc::<Failures>::default();
    let [by_loss, by_error] = [Arc::clone(&failures), Arc::clone(&failures)];
    device.set_device_lost_callback(move |_, message| drop(by_loss.lost.set(message)));
    device.on_uncaptured_error(Arc::new(move |error| {
        let kind =
            if matches!(error, wgpu::Error::Validation { .. }) { &by_error.refused } else { &by_error.lost };
        drop(kind.set(error.to_string()));
    }));
    failures
}
