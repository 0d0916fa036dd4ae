//! The device: memory, kernels, command lists and read-backs, without knowing what any of it is for.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::{Arc, Mutex, mpsc};

use bytemuck::Pod;
use genesplat_core::BackendError;
use wgpu::{
    BindGroupLayout, Buffer, BufferDescriptor, BufferUsages, CommandBuffer, ComputePipeline,
    ComputePipelineDescriptor, Device, DeviceDescriptor, ErrorFilter, Features, MapMode,
    PipelineCompilationOptions, PollType, Queue, ShaderModuleDescriptor, ShaderSource,
};

use crate::adapter;
use crate::layout::SH_FLOATS;
use crate::probe;
use crate::shaders::{Shader, Subgroups};

/// Smallest buffer, bytes: an empty cloud has buffers, too.
const BUFFER_BYTES_MIN: u64 = 256;

/// Buffers are whole vectors.
pub(crate) const BUFFER_BYTES_STEP: u64 = 16;

/// Bytes that may wait to be copied to the device, 64 MiB: until something is submitted and done, whatever is written lies
/// in the host's memory once more. All photos of a scene would be gigabytes.
const WRITTEN_BYTES_MAX: usize = 64 << 20;

/// Bytes that are read back at once, 256 MiB: they pass through a buffer, and a whole cloud may exceed the largest that a
/// device makes.
const READ_BYTES_MAX: u64 = 256 << 20;

/// A part of a buffer, and where it goes on the host.
struct Piece<'a> {
    buffer: &'a Buffer,
    first_byte: u64,
    target: &'a mut [u8],
}

/// A shader with values for its `override` constants.
type KernelKey = (&'static str, Vec<(&'static str, u32)>);

/// A compiled shader, and how its buffers are bound.
#[derive(Clone)]
pub(crate) struct Kernel {
    pub(crate) pipeline: ComputePipeline,
    pub(crate) layout: BindGroupLayout,
}

/// A device, and the kernels that it has compiled.
pub(crate) struct Engine {
    pub(crate) device: Device,
    pub(crate) queue: Queue,
    /// Name and programming interface, for the log.
    pub(crate) name: String,
    /// Largest part of a buffer that a kernel can see, bytes.
    pub(crate) binding_bytes: u64,
    /// Rows of the cloud that a kernel can see at once.
    pub(crate) window_rows: u64,
    buffer_bytes: u64,
    /// Bytes that may be allocated: all that the device has, unless a test wants less.
    pub(crate) memory_bytes: u64,
    /// Bytes that may wait to be copied to the device: [`WRITTEN_BYTES_MAX`], unless a test wants fewer.
    pub(crate) written_bytes_max: usize,
    /// Bytes that are read back at once: [`READ_BYTES_MAX`], unless a test wants fewer.
    pub(crate) read_bytes_max: u64,
    /// Bytes that wait to be copied to the device.
    pub(crate) written: Cell<usize>,
    /// How often the host has waited: what a test counts.
    pub(crate) waits: Cell<u32>,
    pub(crate) timestamps: bool,
    /// Which kernels run.
    pub(crate) subgroups: Subgroups,
    kernels: RefCell<HashMap<KernelKey, Kernel>>,
    lost: Arc<Mutex<Option<String>>>,
    allocated: Rc<Cell<u64>>,
    most_allocated: Cell<u64>,
}

impl Engine {
    /// The best device of this machine.
    pub(crate) fn new() -> Result<Self, BackendError> {
        let adapter = adapter::best()?;
        let info = adapter.get_info();
        let name = format!("{} ({:?})", info.name, info.backend);
        let features = adapter.features() & (Features::TIMESTAMP_QUERY | Features::SUBGROUP);
        let descriptor = DeviceDescriptor {
            label: Some("genesplat"),
            required_features: features,
            required_limits: adapter::required_limits(adapter),
            ..DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| BackendError::Unsupported(format!("{name} cannot be opened: {error}")))?;
        let lost = Arc::new(Mutex::new(None));
        let remember = Arc::clone(&lost);
        device.set_device_lost_callback(move |_, message| note(&remember, message));
        let remember = Arc::clone(&lost);
        device.on_uncaptured_error(Arc::new(move |error| note(&remember, error.to_string())));
        let limits = device.limits();
        let engine = Self {
            binding_bytes: limits.max_storage_buffer_binding_size,
            window_rows: limits.max_storage_buffer_binding_size / (4 * u64::from(SH_FLOATS)),
            buffer_bytes: limits.max_buffer_size,
            memory_bytes: u64::MAX,
            written_bytes_max: WRITTEN_BYTES_MAX,
            read_bytes_max: READ_BYTES_MAX,
            written: Cell::default(),
            waits: Cell::default(),
            device,
            queue,
            name,
            timestamps: features.contains(Features::TIMESTAMP_QUERY),
            subgroups: Subgroups::With,
            kernels: RefCell::default(),
            lost,
            allocated: Rc::default(),
            most_allocated: Cell::default(),
        };
        let trusts = features.contains(Features::SUBGROUP) && probe::subgroup_seats(&engine)?.is_some();
        Ok(if trusts { engine } else { engine.without_subgroups() })
    }

    /// The same, but kernels see at most `rows` rows of the cloud at once: how tests exercise the splitting of columns.
    #[cfg(test)]
    pub(crate) fn with_window_rows(mut self, rows: u64) -> Self {
        self.window_rows = self.window_rows.min(rows);
        self
    }

    /// The same with the kernels for devices without subgroups.
    pub(crate) fn without_subgroups(mut self) -> Self {
        self.subgroups = Subgroups::Without;
        self
    }

    /// A buffer that kernels read and write, of at least `bytes`; its content is zero.
    pub(crate) fn allocate(&self, purpose: &'static str, bytes: u64) -> Result<Memory, BackendError> {
        let bytes = whole_vectors(bytes);
        if self.allocated.get().saturating_add(bytes) > self.memory_bytes {
            return Err(self.out_of_memory(purpose, bytes));
        }
        let usage = BufferUsages::STORAGE
            | BufferUsages::COPY_SRC
            | BufferUsages::COPY_DST
            | BufferUsages::UNIFORM
            | BufferUsages::INDIRECT;
        let buffer = self.create(purpose, bytes, usage)?;
        self.allocated.set(self.allocated.get() + bytes);
        self.most_allocated.set(self.most_allocated.get().max(self.allocated.get()));
        Ok(Memory { buffer, bytes, purpose, allocated: Rc::clone(&self.allocated) })
    }

    /// The same, for what a kernel must see as a whole.
    pub(crate) fn allocate_whole(&self, purpose: &'static str, bytes: u64) -> Result<Memory, BackendError> {
        if whole_vectors(bytes) > self.binding_bytes {
            return Err(self.out_of_memory(purpose, bytes));
        }
        self.allocate(purpose, bytes)
    }

    /// A buffer with content.
    pub(crate) fn upload<T: Pod>(
        &self,
        purpose: &'static str,
        content: &[T],
    ) -> Result<Memory, BackendError> {
        let bytes: &[u8] = bytemuck::cast_slice(content);
        let memory = self.allocate(purpose, bytes.len() as u64)?;
        self.write(&memory, 0, content);
        Ok(memory)
    }

    /// Makes `memory` at least `bytes` large; what it held is lost when it has to grow. Where there is no room for the old
    /// and the new one at once, the old one goes first; where there is none then, nothing is left of it.
    pub(crate) fn reserve(&self, memory: &mut Memory, bytes: u64) -> Result<(), BackendError> {
        // Even no bytes are a buffer, which may have been released.
        if memory.bytes >= bytes.max(BUFFER_BYTES_MIN) {
            return Ok(());
        }
        *memory = match self.allocate_whole(memory.purpose, bytes) {
            Err(BackendError::OutOfMemory { .. }) => {
                memory.release();
                self.wait()?;
                self.allocate_whole(memory.purpose, bytes)?
            }
            made => made?,
        };
        Ok(())
    }

    /// Bytes of all buffers that are in use.
    pub(crate) fn allocated_bytes(&self) -> u64 {
        self.allocated.get()
    }

    /// The most that they have been since this was last asked.
    pub(crate) fn take_most_allocated(&self) -> u64 {
        self.most_allocated.replace(self.allocated.get())
    }

    /// Overwrites part of a buffer, before whatever is submitted next.
    pub(crate) fn write<T: Pod>(&self, memory: &Memory, first_byte: u64, content: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(content);
        let most = self.written_bytes_max;
        for (piece, at) in bytes.chunks(most).zip((first_byte..).step_by(most)) {
            if self.written.get() + piece.len() > most {
                self.flush();
            }
            self.queue.write_buffer(&memory.buffer, at, piece);
            self.written.set(self.written.get() + piece.len());
        }
    }

    /// Copies everything that was written to the device, and frees what it took on the host.
    fn flush(&self) {
        self.submit([]);
        // Whoever waits next, and can say so, hears of a device that is lost.
        let _ = self.wait();
    }

    /// Hands commands to the device, and before them all that was written; does not wait.
    pub(crate) fn submit(&self, commands: impl IntoIterator<Item = CommandBuffer>) {
        self.written.set(0);
        self.queue.submit(commands);
    }

    /// Waits for the device and copies the first `count` values of a buffer to the host.
    pub(crate) fn read_values<T: Pod>(&self, memory: &Memory, count: u64) -> Result<Vec<T>, BackendError> {
        let mut values = bytemuck::zeroed_vec(count as usize);
        self.read([(memory, bytemuck::cast_slice_mut(&mut values))])?;
        Ok(values)
    }

    /// Waits for the device and fills targets (multiples of 4 bytes) from the beginning of their buffers: all at once, or
    /// piece by piece where they are larger than what is read at once.
    pub(crate) fn read<const K: usize>(&self, parts: [(&Memory, &mut [u8]); K]) -> Result<(), BackendError> {
        let most = (self.read_bytes_max.min(self.buffer_bytes) / 4 * 4) as usize;
        let total: usize = parts.iter().map(|(_, target)| target.len()).sum();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = self.create("a read-back", (total.min(most) as u64).max(BUFFER_BYTES_MIN), usage)?;
        let (mut pieces, mut staged) = (Vec::new(), 0);
        for (memory, target) in parts {
            for (first_byte, target) in (0..).step_by(most).zip(target.chunks_mut(most)) {
                if staged + target.len() > most {
                    self.read_pieces(&staging, std::mem::take(&mut pieces))?;
                    staged = 0;
                }
                staged += target.len();
                pieces.push(Piece { buffer: &memory.buffer, first_byte, target });
            }
        }
        self.read_pieces(&staging, pieces)
    }

    /// Pieces that fit `staging`, with one wait.
    fn read_pieces(&self, staging: &Buffer, pieces: Vec<Piece>) -> Result<(), BackendError> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut at = 0;
        for piece in &pieces {
            let bytes = piece.target.len() as u64;
            encoder.copy_buffer_to_buffer(piece.buffer, piece.first_byte, staging, at, bytes);
            at += bytes;
        }
        self.submit([encoder.finish()]);
        self.map(staging)?;
        let mapped =
            staging.slice(..).get_mapped_range().map_err(|error| self.is_lost(&error.to_string()))?;
        let mut rest = &mapped[..];
        for piece in pieces {
            let (bytes, behind) = rest.split_at(piece.target.len());
            piece.target.copy_from_slice(bytes);
            rest = behind;
        }
        drop(mapped);
        staging.unmap();
        Ok(())
    }

    /// Waits until a buffer can be read by the host.
    fn map(&self, staging: &Buffer) -> Result<(), BackendError> {
        let (sender, receiver) = mpsc::channel();
        staging.slice(..).map_async(MapMode::Read, move |result| {
            // Nobody listens any more only when waiting failed already.
            let _ = sender.send(result);
        });
        self.wait()?;
        match receiver.recv() {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(self.is_lost(&error.to_string())),
            Err(error) => Err(self.is_lost(&error.to_string())),
        }
    }

    /// Waits until everything submitted is done; only then is the memory of dropped buffers free.
    pub(crate) fn wait(&self) -> Result<(), BackendError> {
        self.waits.set(self.waits.get() + 1);
        match self.device.poll(PollType::wait_indefinitely()) {
            Ok(_) => self.check(),
            Err(error) => Err(self.is_lost(&error.to_string())),
        }
    }

    /// An error if the device is lost or has refused something.
    pub(crate) fn check(&self) -> Result<(), BackendError> {
        let lost =
            self.lost.lock().map_or_else(|poisoned| poisoned.into_inner().clone(), |lost| lost.clone());
        lost.map_or(Ok(()), |reason| Err(self.is_lost(&reason)))
    }

    fn is_lost(&self, reason: &str) -> BackendError {
        BackendError::DeviceLost { device: self.name.clone(), reason: reason.replace('\n', " ") }
    }

    pub(crate) fn out_of_memory(&self, purpose: &str, wanted: u64) -> BackendError {
        BackendError::OutOfMemory { device: self.name.clone(), wanted, purpose: purpose.into() }
    }

    /// A buffer, or what there is no room for; the device lives on after that.
    fn create(&self, purpose: &str, size: u64, usage: BufferUsages) -> Result<Buffer, BackendError> {
        if size > self.buffer_bytes {
            return Err(self.out_of_memory(purpose, size));
        }
        let scope = self.device.push_error_scope(ErrorFilter::OutOfMemory);
        let descriptor = BufferDescriptor { label: Some(purpose), size, usage, mapped_at_creation: false };
        let buffer = self.device.create_buffer(&descriptor);
        match pollster::block_on(scope.pop()) {
            None => Ok(buffer),
            Some(_) => Err(self.out_of_memory(purpose, size)),
        }
    }

    /// A compiled kernel; compiled when it is first asked for.
    pub(crate) fn kernel(&self, shader: &'static Shader, overrides: &[(&'static str, u32)]) -> Kernel {
        let key = (shader.name, overrides.to_vec());
        if let Some(kernel) = self.kernels.borrow().get(&key) {
            return kernel.clone();
        }
        let module = self.device.create_shader_module(ShaderModuleDescriptor {
            label: Some(shader.name),
            source: ShaderSource::Wgsl(shader.source(self.subgroups).into()),
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

/// Size of a buffer that holds so many bytes.
fn whole_vectors(bytes: u64) -> u64 {
    bytes.next_multiple_of(BUFFER_BYTES_STEP).max(BUFFER_BYTES_MIN)
}

fn note(lost: &Mutex<Option<String>>, message: String) {
    let mut lost = lost.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    lost.get_or_insert(message);
}

/// Memory of the device.
#[derive(Debug)]
pub(crate) struct Memory {
    pub(crate) buffer: Buffer,
    /// Size.
    pub(crate) bytes: u64,
    purpose: &'static str,
    allocated: Rc<Cell<u64>>,
}

impl Memory {
    /// Gives all of it back, once the device has done what was submitted before, and without needing any. Whoever uses
    /// it next has to [`Engine::reserve`] it.
    pub(crate) fn release(&mut self) {
        self.buffer.destroy();
        self.allocated.set(self.allocated.get().saturating_sub(self.bytes));
        self.bytes = 0;
    }
}

impl Drop for Memory {
    /// The device frees the buffer once it has done what was submitted before.
    fn drop(&mut self) {
        self.allocated.set(self.allocated.get().saturating_sub(self.bytes));
    }
}
