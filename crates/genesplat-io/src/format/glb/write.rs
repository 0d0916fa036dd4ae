//! A cloud as a `.glb`.

use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_core::gaussians::sigmoid;
use genesplat_core::spherical_harmonics::coefficients;
use serde_json::{Map, Value, json};

use super::{
    BINARY_CHUNK, COLOUR, COLOUR_SPACE, EXTENSION, JSON_CHUNK, KERNEL, MAGIC, OPACITY, ORDERS, POSITION,
    ROTATION, SCALE, VERSION, harmonic,
};
use crate::format::FormatError;
use crate::format::packing::{byte, half_turn_about_x, normalised, rgb_from_dc, scale};

/// glTF's numbers of types.
const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34962;
const POINTS: u32 = 0;

pub(in crate::format) fn encode(path: &Path, mut cloud: Gaussians) -> Result<Vec<u8>, FormatError> {
    half_turn_about_x(&mut cloud);
    let binary = Vec::with_capacity(row_bytes(cloud.sh_degree_in_use()) * cloud.len());
    let mut parts = Parts { count: cloud.len(), binary, ..Parts::default() };
    add_attributes(&mut parts, &cloud);
    drop(cloud);
    let document = parts.document();
    join(&document, &parts.binary).ok_or_else(|| {
        FormatError::unsupported(path, "would be larger than the 4 GiB that a .glb can have; write an .spz")
    })
}

/// What [`add_attributes`] writes of a Gaussian: position, rotation, scales, opacity, harmonics, and four
/// bytes of colour.
fn row_bytes(sh_degree: u8) -> usize {
    (3 + 4 + 3 + 1 + 3 * coefficients(sh_degree)) * size_of::<f32>() + 4
}

fn add_attributes(parts: &mut Parts, cloud: &Gaussians) {
    parts.add_floats(POSITION, cloud.positions.iter().copied());
    // Positions must have bounds.
    let accessor = parts.accessors.last_mut().expect("positions have been added");
    for (bound, pick) in [("min", f32::min as fn(f32, f32) -> f32), ("max", f32::max)] {
        let of_axis =
            |axis: usize| cloud.positions.iter().map(|position| position[axis]).reduce(pick).unwrap_or(0.0);
        accessor[bound] = json!([of_axis(0), of_axis(1), of_axis(2)]);
    }
    parts.add_floats(
        ROTATION,
        cloud.rotations.iter().map(|&rotation| {
            let [w, x, y, z] = normalised(rotation);
            [x, y, z, w]
        }),
    );
    parts.add_floats(SCALE, cloud.log_scales.iter().map(|log_scale| log_scale.map(scale)));
    parts.add_floats(OPACITY, cloud.opacity_logits.iter().map(|&logit| [sigmoid(logit)]));
    let colours = cloud.sh.iter().zip(&cloud.opacity_logits).map(|(row, &logit)| {
        let [r, g, b] = [0, 1, 2].map(|channel| byte(rgb_from_dc(row[channel])));
        [r, g, b, byte(sigmoid(logit))]
    });
    parts.add_colours(colours);
    let degree = usize::from(cloud.sh_degree_in_use());
    for (l, orders) in ORDERS.into_iter().enumerate().take(degree + 1) {
        for n in 0..orders {
            let slot = if l == 0 { 0 } else { 3 * (coefficients(l as u8 - 1) + n) };
            parts.add_floats(
                &harmonic(l, n),
                cloud.sh.iter().map(|row| [row[slot], row[slot + 1], row[slot + 2]]),
            );
        }
    }
}

/// A document while it grows.
#[derive(Default)]
struct Parts {
    count: usize,
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Parts {
    fn add_floats<const K: usize>(&mut self, name: &str, rows: impl Iterator<Item = [f32; K]>) {
        let start = self.binary.len();
        rows.for_each(|row| row.iter().for_each(|value| self.binary.extend(value.to_le_bytes())));
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][K - 1];
        self.add(name, start, json!({ "componentType": FLOAT, "type": kind }));
    }

    fn add_colours(&mut self, rows: impl Iterator<Item = [u8; 4]>) {
        let start = self.binary.len();
        rows.for_each(|row| self.binary.extend(row));
        self.add(
            COLOUR,
            start,
            json!({ "componentType": UNSIGNED_BYTE, "type": "VEC4", "normalized": true }),
        );
    }

    /// Registers what has been written since `start`.
    fn add(&mut self, name: &str, start: usize, mut accessor: Value) {
        let length = self.binary.len() - start;
        self.views
            .push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": ARRAY_BUFFER }));
        accessor["bufferView"] = json!(self.views.len() - 1);
        accessor["count"] = json!(self.count);
        self.attributes.insert(name.into(), json!(self.accessors.len()));
        self.accessors.push(accessor);
    }

    fn document(&self) -> Value {
        json!({
            "asset": { "version": "2.0", "generator": "genesplat" },
            "extensionsUsed": [EXTENSION],
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": [{
                "mode": POINTS,
                "attributes": self.attributes,
                "extensions": { EXTENSION: { "kernel": KERNEL, "colorSpace": COLOUR_SPACE } },
            }] }],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.binary.len() }],
        })
    }
}

/// Header, JSON and binary part, each padded to a multiple of 4 bytes; `None` where the size has no 32 bits.
fn join(document: &Value, binary: &[u8]) -> Option<Vec<u8>> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let padded = binary.len().next_multiple_of(4);
    let length = u32::try_from(12 + 8 + json.len() + 8 + padded).ok()?;
    let mut bytes = Vec::with_capacity(length as usize);
    bytes.extend(MAGIC);
    [VERSION, length, json.len() as u32].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.extend(JSON_CHUNK);
    bytes.extend(json);
    bytes.extend((padded as u32).to_le_bytes());
    bytes.extend(BINARY_CHUNK);
    bytes.extend(binary);
    bytes.resize(length as usize, 0);
    Some(bytes)
}
