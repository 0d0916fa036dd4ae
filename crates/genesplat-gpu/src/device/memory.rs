//! Memory of the device: buffers, what is written to them, and what is read back.

use std::cell::Cell;
use std::error::Error;
use std::rc::Rc;
use std::sync::mpsc::{self, Receiver};

use bytemuck::Pod;
use genesplat_core::BackendError;
use genesplat_core::memory::ensure_memory;
use wgpu::{Buffer, BufferDescriptor, BufferUsages, ErrorFilter, MapMode, SubmissionIndex};

use crate::Result;
use crate::device::Engine;
use crate::device::bound::Bound;

/// Smallest buffer, bytes: an empty cloud has buffers, too.
const BUFFER_BYTES_MIN: u64 = 256;

/// Buffers are whole vectors.
pub(crate) const BUFFER_BYTES_STEP: u64 = 16;

/// Bytes that may wait to be copied to the device, 64 MiB: they lie in the host's memory once more.
const WRITTEN_BYTES_MAX: usize = 64 << 20;

/// Bytes that are read back at once, 256 MiB: a whole cloud may exceed the largest buffer that a device
/// makes.
const READ_BYTES_MAX: u64 = 256 << 20;

#[derive(Debug)]
pub(crate) struct Memory {
    pub(crate) buffer: Buffer,
    pub(crate) bytes: u64,
    purpose: &'static str,
    /// No other memory has it.
    number: u64,
    allocated: Rc<Cell<u64>>,
    bound: Rc<Bound>,
}

impl Memory {
    /// Frees it, once the device has done what was submitted before, until it is [`Engine::reserve`]d anew.
    pub(crate) fn release(&mut self) {
        self.buffer.destroy();
        self.bound.forget();
        self.allocated.set(self.allocated.get().saturating_sub(self.bytes));
        self.bytes = 0;
    }

    pub(crate) fn all(&self) -> Part<'_> {
        Part { buffer: &self.buffer, number: self.number, first_byte: 0, bytes: self.bytes }
    }

    /// `bytes` from `first_byte` on; at least 16, since no binding may be empty.
    pub(crate) fn part(&self, first_byte: u64, bytes: u64) -> Part<'_> {
        Part { buffer: &self.buffer, number: self.number, first_byte, bytes: bytes.max(16) }
    }
}

impl Drop for Memory {
    /// The device frees the buffer once it has done what was submitted before.
    fn drop(&mut self) {
        self.bound.forget();
        self.allocated.set(self.allocated.get().saturating_sub(self.bytes));
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Part<'a> {
    pub(super) buffer: &'a Buffer,
    pub(super) number: u64,
    pub(super) first_byte: u64,
    pub(super) bytes: u64,
}

/// How much is allocated, and how much is on its way to the device.
pub(crate) struct MemoryUse {
    /// Limits, which tests lower: bytes that may be allocated, that may wait to be copied, that are read at
    /// once.
    pub(crate) limit_bytes: u64,
    pub(crate) written_bytes_max: usize,
    pub(crate) read_bytes_max: u64,
    pub(crate) written: Cell<usize>,
    pub(crate) allocated: Rc<Cell<u64>>,
    pub(crate) most_allocated: Cell<u64>,
    /// Memories that were made.
    made: Cell<u64>,
    pub(super) bound: Rc<Bound>,
}

impl Default for MemoryUse {
    fn default() -> Self {
        Self {
            limit_bytes: u64::MAX,
            written_bytes_max: WRITTEN_BYTES_MAX,
            read_bytes_max: READ_BYTES_MAX,
            written: Cell::default(),
            allocated: Rc::default(),
            most_allocated: Cell::default(),
            made: Cell::default(),
            bound: Rc::default(),
        }
    }
}

type Mapped = std::result::Result<(), wgpu::BufferAsyncError>;

/// Bytes on their way to the host.
pub(crate) struct Reading {
    staging: Buffer,
    mapped: Receiver<Mapped>,
    submission: SubmissionIndex,
}

/// A part of a buffer, from a byte on, and where it goes on the host.
type Piece<'a> = (&'a Buffer, u64, &'a mut [u8]);

impl Engine {
    /// A buffer that kernels read and write, of at least `bytes`; its content is zero.
    pub(crate) fn allocate(&self, purpose: &'static str, bytes: u64) -> Result<Memory> {
        let (bytes, usage) = (whole_vectors(bytes), &self.usage);
        if usage.allocated.get().saturating_add(bytes) > usage.limit_bytes {
            return Err(self.out_of_memory(purpose, bytes));
        }
        let kind = BufferUsages::STORAGE
            | BufferUsages::COPY_SRC
            | BufferUsages::COPY_DST
            | BufferUsages::UNIFORM
            | BufferUsages::INDIRECT
            | BufferUsages::QUERY_RESOLVE;
        let buffer = self.create(purpose, bytes, kind)?;
        usage.allocated.set(usage.allocated.get() + bytes);
        usage.most_allocated.set(usage.most_allocated.get().max(usage.allocated.get()));
        let number = usage.made.replace(usage.made.get() + 1);
        let (allocated, bound) = (Rc::clone(&usage.allocated), Rc::clone(&usage.bound));
        Ok(Memory { buffer, bytes, purpose, number, allocated, bound })
    }

    /// Makes `memory` at least `bytes` large; what it held is lost when it has to grow. Where there is no
    /// memory for the old and the new one at once, the old one goes first; where there is none then, nothing
    /// is left of it.
    pub(crate) fn reserve(&self, memory: &mut Memory, bytes: u64) -> Result<()> {
        // Even no bytes are a buffer, which may have been released.
        if memory.bytes >= bytes.max(BUFFER_BYTES_MIN) {
            return Ok(());
        }
        let purpose = memory.purpose;
        // A kernel must see all of it.
        if whole_vectors(bytes) > self.binding_bytes {
            return Err(self.out_of_memory(purpose, bytes));
        }
        *memory = match self.allocate(purpose, bytes) {
            Err(BackendError::OutOfMemory { .. }) => {
                memory.release();
                self.wait()?;
                self.allocate(purpose, bytes)?
            }
            made => made?,
        };
        Ok(())
    }

    /// A buffer, or an error; the device lives on after that.
    fn create(&self, purpose: &str, size: u64, usage: BufferUsages) -> Result<Buffer> {
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

    pub(crate) fn out_of_memory(&self, purpose: &str, wanted: u64) -> BackendError {
        BackendError::OutOfMemory { device: self.name.clone(), wanted, purpose: purpose.into() }
    }

    pub(crate) fn upload<T: Pod>(&self, purpose: &'static str, content: &[T]) -> Result<Memory> {
        let bytes: &[u8] = bytemuck::cast_slice(content);
        let memory = self.allocate(purpose, bytes.len() as u64)?;
        self.write(&memory, 0, content);
        Ok(memory)
    }

    /// Overwrites part of a buffer, before whatever is submitted next.
    pub(crate) fn write<T: Pod>(&self, memory: &Memory, first_byte: u64, content: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(content);
        let (most, written) = (self.usage.written_bytes_max, &self.usage.written);
        for (piece, at) in bytes.chunks(most).zip((first_byte..).step_by(most)) {
            if written.get() + piece.len() > most {
                self.flush();
            }
            self.queue.write_buffer(&memory.buffer, at, piece);
            written.set(written.get() + piece.len());
        }
    }

    /// Copies everything that was written to the device, and frees what it took on the host.
    fn flush(&self) {
        self.submit([]);
        // The next wait that can return an error tells of a lost device.
        let _ = self.wait();
    }

    /// Waits for the device and copies the first `count` values of a buffer to the host.
    pub(crate) fn read_values<T: Pod>(&self, memory: &Memory, count: u64) -> Result<Vec<T>> {
        // What callers make of the values is about as large again.
        ensure_memory(2 * size_of::<T>() * count as usize, "what the device holds")?;
        let mut values = bytemuck::zeroed_vec(count as usize);
        self.read([(memory, bytemuck::cast_slice_mut(&mut values))])?;
        Ok(values)
    }

    /// Waits for the device and fills targets (multiples of 4 bytes) from the beginning of their buffers.
    pub(crate) fn read<const K: usize>(&self, parts: [(&Memory, &mut [u8]); K]) -> Result<()> {
        let most = (self.usage.read_bytes_max.min(self.buffer_bytes) / 4 * 4) as usize;
        let total: usize = parts.iter().map(|(_, target)| target.len()).sum();
        let staging = self.staging(total.min(most) as u64)?;
        let (mut pieces, mut staged) = (Vec::new(), 0);
        for (memory, target) in parts {
            for (first_byte, target) in (0..).step_by(most).zip(target.chunks_mut(most)) {
                if staged + target.len() > most {
                    self.read_pieces(&staging, std::mem::take(&mut pieces))?;
                    staged = 0;
                }
                staged += target.len();
                pieces.push((&memory.buffer, first_byte, target));
            }
        }
        self.read_pieces(&staging, pieces)
    }

    /// A buffer that the host can read, of at least `bytes`: for small answers always the same.
    fn staging(&self, bytes: u64) -> Result<Buffer> {
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        if bytes > BUFFER_BYTES_MIN {
            return self.create("a read-back", bytes, usage);
        }
        if let Some(kept) = self.staging.get() {
            return Ok(kept.clone());
        }
        let made = self.create("a small read-back", BUFFER_BYTES_MIN, usage)?;
        Ok(self.staging.get_or_init(|| made).clone())
    }

    /// Copies the first `bytes` of a buffer, after what was submitted before, to where the host can read them
    /// later.
    pub(crate) fn begin_reading(&self, memory: &Memory, bytes: u64) -> Result<Reading> {
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let staging = self.create("a small read-back", bytes, usage)?;
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&memory.buffer, 0, &staging, 0, bytes);
        self.read_bytes.set(self.read_bytes.get() + bytes);
        let submission = self.submit([encoder.finish()]);
        let mapped = map(&staging);
        Ok(Reading { staging, mapped, submission })
    }

    /// Fills `target`, for which the reading must be as large; waits for what was submitted before it began,
    /// and for nothing that came later.
    pub(crate) fn finish_reading(&self, reading: Reading, target: &mut [u8]) -> Result<()> {
        let Reading { staging, mapped, submission } = reading;
        self.wait_for(Some(submission))?;
        self.when_mapped(&mapped)?;
        let view = staging.slice(..).get_mapped_range().map_err(|error| self.is_lost(&error.to_string()))?;
        target.copy_from_slice(&view);
        Ok(())
    }

    /// An error where the host cannot read a buffer that it has waited for.
    fn when_mapped(&self, mapped: &Receiver<Mapped>) -> Result<()> {
        let is_lost = |error: &dyn Error| self.is_lost(&error.to_string());
        mapped.recv().map_err(|error| is_lost(&error))?.map_err(|error| is_lost(&error))
    }

    /// Pieces that fit `staging`, with one wait.
    fn read_pieces(&self, staging: &Buffer, pieces: Vec<Piece>) -> Result<()> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let mut at = 0;
        for (buffer, first_byte, target) in &pieces {
            let bytes = target.len() as u64;
            encoder.copy_buffer_to_buffer(buffer, *first_byte, staging, at, bytes);
            at += bytes;
        }
        self.read_bytes.set(self.read_bytes.get() + at);
        self.submit([encoder.finish()]);
        let mapped = map(staging);
        self.wait()?;
        self.when_mapped(&mapped)?;
        let mapped =
            staging.slice(..).get_mapped_range().map_err(|error| self.is_lost(&error.to_string()))?;
        let mut rest = &mapped[..];
        for (_, _, target) in pieces {
            let (bytes, behind) = rest.split_at(target.len());
            target.copy_from_slice(bytes);
            rest = behind;
        }
        drop(mapped);
        staging.unmap();
        Ok(())
    }
}

/// Asks to read a buffer, once what was submitted is done.
fn map(staging: &Buffer) -> Receiver<Mapped> {
    let (sender, receiver) = mpsc::channel();
    staging.slice(..).map_async(MapMode::Read, move |result| {
        // The receiver is gone only when nobody waits any more.
        let _ = sender.send(result);
    });
    receiver
}

fn whole_vectors(bytes: u64) -> u64 {
    bytes.next_multiple_of(BUFFER_BYTES_STEP).max(BUFFER_BYTES_MIN)
}
