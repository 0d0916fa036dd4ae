//! A list of dispatches, stage by stage. It is submitted at once, unless a weak device would take too long
//! for it: some drivers take a submission of two seconds for a hang. How long it takes is predicted by its
//! instructions.

use wgpu::{CommandEncoder, ComputePass, ComputePassDescriptor, ComputePassTimestampWrites};

use crate::device::shaders::Shader;
use crate::device::timing::{TIMED_PASSES, Timestamps};
use crate::device::{Engine, Memory, Part};
use crate::layout::{GRID_WIDTH, GROUP};

/// Instructions of an invocation, roughly: the longest kernels have 1,500, most far less (`lab/gpu-code.md`).
pub(crate) const INVOCATION: u64 = 1_000;

#[derive(Clone, Copy)]
pub(crate) enum Grid<'a> {
    /// Enough of 256 invocations for so many items.
    Items(u64),
    /// So many, in a row that wraps.
    Groups(u64),
    /// Exactly these, in three dimensions.
    Exact([u32; 3]),
    /// As a slot of this buffer says when it is their turn.
    Device(&'a Memory, u32),
}

impl Grid<'_> {
    /// Instructions that it is predicted to take; of those that only the device knows, nothing.
    fn instructions(self) -> u64 {
        let group = u64::from(GROUP);
        INVOCATION
            * match self {
                Grid::Items(items) => items,
                Grid::Groups(groups) => groups * group,
                Grid::Exact(groups) => groups.map(u64::from).iter().product::<u64>() * group,
                Grid::Device(..) => 0,
            }
    }
}

pub(crate) struct Recorder<'a> {
    engine: &'a Engine,
    encoder: CommandEncoder,
    pass: Option<ComputePass<'static>>,
    stage: &'static str,
    timestamps: Option<&'a mut Timestamps>,
    /// What is recorded and not yet submitted is predicted to take so many.
    instructions: u64,
}

impl<'a> Recorder<'a> {
    pub(crate) fn new(engine: &'a Engine, timestamps: Option<&'a mut Timestamps>) -> Self {
        let encoder = engine.device.create_command_encoder(&Default::default());
        Self { engine, encoder, pass: None, stage: "", timestamps, instructions: 0 }
    }

    /// What follows belongs to this stage: a pass of its own where stages are timed.
    pub(crate) fn stage(&mut self, name: &'static str) {
        if self.timestamps.is_some() {
            self.pass = None;
        }
        self.stage = name;
    }

    pub(crate) fn clear(&mut self, memory: &Memory, bytes: u64) {
        self.pass = None;
        self.encoder.clear_buffer(&memory.buffer, 0, Some(bytes.next_multiple_of(16).min(memory.bytes)));
    }

    /// Runs a kernel; `parts` are its bindings in order.
    pub(crate) fn run(&mut self, shader: &'static Shader, parts: &[Part], grid: Grid) {
        self.run_with(shader, &[], parts, grid);
    }

    /// The same with values for `override` constants.
    pub(crate) fn run_with(
        &mut self,
        shader: &'static Shader,
        overrides: &[(&'static str, u32)],
        parts: &[Part],
        grid: Grid,
    ) {
        self.run_long(shader, overrides, parts, grid, grid.instructions());
    }

    /// Instructions that a submission is to take at most, and so a dispatch.
    pub(crate) fn instructions_max(&self) -> u64 {
        self.engine.instructions_max
    }

    /// The same for what is predicted to take so many instructions, because it has long loops, or only the
    /// device knows its grid.
    pub(crate) fn run_long(
        &mut self,
        shader: &'static Shader,
        overrides: &[(&'static str, u32)],
        parts: &[Part],
        grid: Grid,
        instructions: u64,
    ) {
        if self.instructions > 0 && self.instructions + instructions > self.instructions_max() {
            self.submit_so_far();
        }
        self.instructions += instructions;
        self.engine.dispatches.set(self.engine.dispatches.get() + 1);
        let (kernel, group) = self.engine.bound(shader, overrides, parts);
        if self.pass.is_none() {
            self.pass = Some(self.begin_pass());
        }
        let Some(pass) = &mut self.pass else { return };
        pass.set_pipeline(&kernel.pipeline);
        pass.set_bind_group(0, &group, &[]);
        match grid {
            Grid::Items(items) => dispatch_row(pass, items.div_ceil(GROUP.into())),
            Grid::Groups(groups) => dispatch_row(pass, groups),
            Grid::Exact([x, y, z]) => pass.dispatch_workgroups(x, y, z),
            Grid::Device(memory, slot) => {
                pass.dispatch_workgroups_indirect(&memory.buffer, u64::from(slot) * 12)
            }
        }
    }

    fn begin_pass(&mut self) -> ComputePass<'static> {
        let timestamp_writes = self.timestamps.as_deref_mut().and_then(|timestamps| {
            let index = timestamps.stages.len() as u32;
            (index < TIMED_PASSES).then(|| {
                timestamps.stages.push(self.stage);
                ComputePassTimestampWrites {
                    query_set: &timestamps.queries,
                    beginning_of_pass_write_index: Some(2 * index),
                    end_of_pass_write_index: Some(2 * index + 1),
                }
            })
        });
        let descriptor = ComputePassDescriptor { label: Some(self.stage), timestamp_writes };
        self.encoder.begin_compute_pass(&descriptor).forget_lifetime()
    }

    fn submit_so_far(&mut self) {
        self.pass = None;
        let next = self.engine.device.create_command_encoder(&Default::default());
        self.engine.submit([std::mem::replace(&mut self.encoder, next).finish()]);
        self.instructions = 0;
    }

    /// Hands everything to the device; does not wait.
    pub(crate) fn submit(mut self) {
        self.pass = None;
        self.engine.submit([self.encoder.finish()]);
    }
}

fn dispatch_row(pass: &mut ComputePass, groups: u64) {
    let width = u64::from(GRID_WIDTH);
    if groups > 0 {
        pass.dispatch_workgroups(groups.min(width) as u32, groups.div_ceil(width) as u32, 1);
    }
}
