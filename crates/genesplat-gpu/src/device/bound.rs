//! What kernels are bound to, kept from step to step: nothing changes there until memory is freed, and a bind
//! group costs more than a dispatch.

use std::cell::RefCell;
use std::collections::HashMap;

use wgpu::{BindGroup, BindGroupDescriptor, BindGroupEntry, BindingResource, BufferBinding};

use crate::device::Part;
use crate::device::engine::{Engine, Kernel, KernelKey};
use crate::device::shaders::Shader;

/// A kernel, and the parts of memories that it is bound to: number of the memory, first byte, bytes.
type Key = (KernelKey, Vec<(u64, u64, u64)>);

/// Kernels with their bindings. They would keep memory alive, so whoever frees some forgets all of them.
#[derive(Debug, Default)]
pub(crate) struct Bound(RefCell<HashMap<Key, (Kernel, BindGroup)>>);

impl Bound {
    pub(crate) fn forget(&self) {
        self.0.borrow_mut().clear();
    }
}

impl Engine {
    /// A kernel with its bindings, in order; made when it is first asked for.
    pub(super) fn bound(
        &self,
        shader: &'static Shader,
        overrides: &[(&'static str, u32)],
        parts: &[Part],
    ) -> (Kernel, BindGroup) {
        let places = parts.iter().map(|part| (part.number, part.first_byte, part.bytes)).collect();
        let key = ((shader.name, overrides.to_vec()), places);
        if let Some(bound) = self.usage.bound.0.borrow().get(&key) {
            return bound.clone();
        }
        let kernel = self.kernel(shader, overrides);
        let entries: Vec<BindGroupEntry> = (0..)
            .zip(parts)
            .map(|(binding, part)| BindGroupEntry {
                binding,
                resource: BindingResource::Buffer(BufferBinding {
                    buffer: part.buffer,
                    offset: part.first_byte,
                    size: std::num::NonZero::new(part.bytes),
                }),
            })
            .collect();
        let group = self.device.create_bind_group(&BindGroupDescriptor {
            label: Some(shader.name),
            layout: &kernel.layout,
            entries: &entries,
        });
        let bound = (kernel, group);
        self.usage.bound.0.borrow_mut().insert(key, bound.clone());
        bound
    }
}
