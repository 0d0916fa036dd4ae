//! Rows of a PLY file from and to the columns of a cloud.

use std::io::{self, Read, Write};
use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_core::spherical_harmonics::{SH_COEFFICIENTS, SH_STRIDE, coefficients, sh_index};

use super::PlyError;
use super::field::{Field, Scalar};
use super::header::PlyHeader;

/// What is to be given where Gaussians are read.
const SPLAT: &str = "a splat, as trainers of Gaussians write it (point_cloud.ply)";

/// Rows that are read at once.
const CHUNK_ROWS: usize = 4096;

/// Names of the properties in the order in which they are written.
pub(super) fn property_names(filter_3d: bool) -> Vec<String> {
    let numbered = |stem: &str, count: usize| (0..count).map(|i| format!("{stem}_{i}")).collect::<Vec<_>>();
    let named = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let mut names = named(&["x", "y", "z", "nx", "ny", "nz"]);
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", SH_STRIDE - 3));
    names.extend(named(&["opacity"]));
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    names.extend(filter_3d.then(|| "filter_3D".to_owned()));
    names
}

/// Where each parameter lies in a row.
pub(super) struct Layout {
    position: [Field; 3],
    log_scale: [Field; 3],
    rotation: [Field; 4],
    opacity: Field,
    /// Index in a row of [`Gaussians::sh`], and the field that fills it.
    sh: Vec<(usize, Field)>,
    filter_3d: Option<Field>,
    row_bytes: usize,
}

impl Layout {
    /// Finds every parameter among the properties of `header`.
    pub(super) fn of(header: &PlyHeader, path: &Path) -> Result<Self, PlyError> {
        let find = |name: String| header.field(&name, path, SPLAT);
        let position = ["x", "y", "z"].map(|name| find(name.into()));
        let scale: [_; 3] = std::array::from_fn(|axis| find(format!("scale_{axis}")));
        let rotation: [_; 4] = std::array::from_fn(|part| find(format!("rot_{part}")));
        let sh = sh_properties(header.sh_degree);
        Ok(Self {
            position: all(position)?,
            opacity: find("opacity".into())?,
            log_scale: all(scale)?,
            rotation: all(rotation)?,
            sh: sh.map(|(slot, name)| Ok((slot, find(name)?))).collect::<Result<_, _>>()?,
            filter_3d: header.has_filter_3d.then(|| find("filter_3D".into())).transpose()?,
            row_bytes: header.row_bytes,
        })
    }

    /// Reads `count` rows; the caller has checked that the file holds them.
    pub(super) fn read(&self, count: usize, reader: &mut impl Read) -> io::Result<Gaussians> {
        let mut cloud =
            Gaussians { filter_3d: self.filter_3d.map(|_| Vec::with_capacity(count)), ..empty(count) };
        let mut chunk = vec![0; CHUNK_ROWS.min(count) * self.row_bytes];
        let mut left = count;
        while left > 0 {
            let rows = left.min(CHUNK_ROWS);
            let bytes = &mut chunk[..rows * self.row_bytes];
            reader.read_exact(bytes)?;
            bytes.chunks_exact(self.row_bytes).for_each(|row| self.push(row, &mut cloud));
            left -= rows;
        }
        Ok(cloud)
    }

    fn push(&self, row: &[u8], cloud: &mut Gaussians) {
        cloud.positions.push(self.position.map(|field| field.value(row)));
        cloud.log_scales.push(self.log_scale.map(|field| field.value(row)));
        cloud.rotations.push(self.rotation.map(|field| field.value(row)));
        cloud.opacity_logits.push(self.opacity.value(row));
        let mut sh = [0.0; SH_STRIDE];
        self.sh.iter().for_each(|&(slot, field)| sh[slot] = field.value(row));
        cloud.sh.push(sh);
        if let (Some(field), Some(filter)) = (self.filter_3d, &mut cloud.filter_3d) {
            filter.push(field.value(row));
        }
    }
}

/// Each harmonic's index in a row of [`Gaussians::sh`], with the property that holds it in a file of `degree`.
fn sh_properties(degree: u8) -> impl Iterator<Item = (usize, String)> {
    let rest = coefficients(degree) - 1;
    (0..3).flat_map(move |channel| {
        let dc = std::iter::once((sh_index(channel, 0), format!("f_dc_{channel}")));
        dc.chain((0..rest).map(move |k| (sh_index(channel, 1 + k), format!("f_rest_{}", channel * rest + k))))
    })
}

fn all<const K: usize>(fields: [Result<Field, PlyError>; K]) -> Result<[Field; K], PlyError> {
    let mut found = [Field { scalar: Scalar::F32, offset: 0 }; K];
    for (slot, field) in found.iter_mut().zip(fields) {
        *slot = field?;
    }
    Ok(found)
}

fn empty(capacity: usize) -> Gaussians {
    Gaussians {
        positions: Vec::with_capacity(capacity),
        log_scales: Vec::with_capacity(capacity),
        rotations: Vec::with_capacity(capacity),
        opacity_logits: Vec::with_capacity(capacity),
        sh: Vec::with_capacity(capacity),
        filter_3d: None,
    }
}

/// Writes every row of `cloud` in the order of [`property_names`].
pub(super) fn write(cloud: &Gaussians, out: &mut impl Write) -> io::Result<()> {
    const NORMAL: [f32; 3] = [0.0; 3];
    let mut bytes = Vec::new();
    for row in 0..cloud.len() {
        let sh = &cloud.sh[row];
        let rest = (0..3).flat_map(|channel| (1..SH_COEFFICIENTS).map(move |k| &sh[sh_index(channel, k)]));
        let values = (cloud.positions[row].iter())
            .chain(&NORMAL)
            .chain(&sh[..3])
            .chain(rest)
            .chain([&cloud.opacity_logits[row]])
            .chain(&cloud.log_scales[row])
            .chain(&cloud.rotations[row])
            .chain(cloud.filter_3d.as_ref().map(|filter| &filter[row]));
        bytes.clear();
        values.for_each(|value| bytes.extend(value.to_le_bytes()));
        out.write_all(&bytes)?;
    }
    Ok(())
}
