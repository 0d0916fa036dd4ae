//! Models out, in the binary form: what [`super::read_model`] reads back, and what other trainers read.
//!
//! Features and tracks are written empty, which every reader of splat scenes accepts.

use std::io::{self, Write};
use std::path::Path;

use super::{Form, ImageRecord, Model, models};
use crate::own;

/// Writes the three files of `model` into `folder`, which is made if it is missing. Ids of photos and points
/// are their 1-based places. Every bit is kept. A lens that none of COLMAP's models can say is an error.
pub fn write_model(folder: &Path, model: &Model) -> io::Result<()> {
    let file = |stem| Form::Binary.file(Path::new(""), stem);
    own::write(folder, file("cameras"), |out| cameras(out, model))?;
    own::write(folder, file("images"), |out| images(out, model))?;
    own::write(folder, file("points3D"), |out| points(out, model))
}

fn put_f64s(out: &mut impl Write, values: impl IntoIterator<Item = f64>) -> io::Result<()> {
    values.into_iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

fn put_count(out: &mut impl Write, count: usize) -> io::Result<()> {
    out.write_all(&(count as u64).to_le_bytes())
}

fn cameras(out: &mut impl Write, model: &Model) -> io::Result<()> {
    put_count(out, model.cameras.len())?;
    for (id, camera) in &model.cameras {
        let Some((name, coefficients)) = models::of_lens(camera.lens.as_ref()) else {
            let problem = format!("COLMAP has no model for the lens of camera {id}");
            return Err(io::Error::new(io::ErrorKind::Unsupported, problem));
        };
        out.write_all(&id.to_le_bytes())?;
        out.write_all(&models::id(name).to_le_bytes())?;
        out.write_all(&u64::from(camera.width).to_le_bytes())?;
        out.write_all(&u64::from(camera.height).to_le_bytes())?;
        match name {
            models::ROUND => put_f64s(out, [camera.width, camera.height].map(f64::from))?,
            _ => put_f64s(out, camera.focal_px.into_iter().chain(camera.principal_px).chain(coefficients))?,
        }
    }
    Ok(())
}

fn images(out: &mut impl Write, model: &Model) -> io::Result<()> {
    put_count(out, model.images.len())?;
    for (id, ImageRecord { name, camera, rotation, translation }) in (1u32..).zip(&model.images) {
        out.write_all(&id.to_le_bytes())?;
        put_f64s(out, rotation.iter().chain(translation).copied())?;
        out.write_all(&camera.to_le_bytes())?;
        out.write_all(name.as_bytes())?;
        out.write_all(&[0])?;
        put_count(out, 0)?;
    }
    Ok(())
}

fn points(out: &mut impl Write, model: &Model) -> io::Result<()> {
    put_count(out, model.points.len())?;
    for (id, point) in (1u64..).zip(&model.points) {
        out.write_all(&id.to_le_bytes())?;
        put_f64s(out, point.position.map(f64::from))?;
        out.write_all(&point.rgb)?;
        put_f64s(out, [0.0])?;
        put_count(out, 0)?;
    }
    Ok(())
}
