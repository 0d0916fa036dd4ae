//! Models out, in both forms: what [`super::read_model`] reads back, and what other trainers read.
//!
//! Features and tracks are written empty, which every reader of splat scenes accepts.

use std::io::{self, Write};
use std::path::Path;

use super::{Form, ImageRecord, Model};
use crate::atomic::write_atomically;

/// COLMAP's number of the model PINHOLE.
const PINHOLE: i32 = 1;

/// Writes the three files of `model` into `folder`, which is made if it is missing.
///
/// Ids of photos and points are their 1-based places. The binary form keeps every bit; so does the text form, because
/// numbers are written with as many digits as their type needs.
pub fn write_model(folder: &Path, form: Form, model: &Model) -> io::Result<()> {
    let [cameras, images, points] = ["cameras", "images", "points3D"].map(|stem| form.file(folder, stem));
    match form {
        Form::Binary => {
            write_atomically(&cameras, |out| binary_cameras(out, model))?;
            write_atomically(&images, |out| binary_images(out, model))?;
            write_atomically(&points, |out| binary_points(out, model))
        }
        Form::Text => {
            write_atomically(&cameras, |out| text_cameras(out, model))?;
            write_atomically(&images, |out| text_images(out, model))?;
            write_atomically(&points, |out| text_points(out, model))
        }
    }
}

fn put_f64s(out: &mut impl Write, values: impl IntoIterator<Item = f64>) -> io::Result<()> {
    values.into_iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

fn put_count(out: &mut impl Write, count: usize) -> io::Result<()> {
    out.write_all(&(count as u64).to_le_bytes())
}

fn binary_cameras(out: &mut impl Write, model: &Model) -> io::Result<()> {
    put_count(out, model.cameras.len())?;
    for (id, camera) in &model.cameras {
        out.write_all(&id.to_le_bytes())?;
        out.write_all(&PINHOLE.to_le_bytes())?;
        out.write_all(&u64::from(camera.width).to_le_bytes())?;
        out.write_all(&u64::from(camera.height).to_le_bytes())?;
        put_f64s(out, camera.focal_px.into_iter().chain(camera.principal_px))?;
    }
    Ok(())
}

fn binary_images(out: &mut impl Write, model: &Model) -> io::Result<()> {
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

fn binary_points(out: &mut impl Write, model: &Model) -> io::Result<()> {
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

fn text_cameras(out: &mut impl Write, model: &Model) -> io::Result<()> {
    writeln!(out, "# CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS")?;
    for (id, camera) in &model.cameras {
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
        writeln!(out, "{id} PINHOLE {} {} {fx} {fy} {cx} {cy}", camera.width, camera.height)?;
    }
    Ok(())
}

fn text_images(out: &mut impl Write, model: &Model) -> io::Result<()> {
    writeln!(out, "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of features (none)")?;
    for (id, image) in (1..).zip(&model.images) {
        let ([qw, qx, qy, qz], [tx, ty, tz]) = (image.rotation, image.translation);
        writeln!(out, "{id} {qw} {qx} {qy} {qz} {tx} {ty} {tz} {} {}\n", image.camera, image.name)?;
    }
    Ok(())
}

fn text_points(out: &mut impl Write, model: &Model) -> io::Result<()> {
    writeln!(out, "# POINT3D_ID X Y Z R G B ERROR TRACK (none)")?;
    for (id, point) in (1..).zip(&model.points) {
        // As f64: digits of an f32 that are read as f64 and rounded again could end one step off.
        let ([x, y, z], [r, g, b]) = (point.position.map(f64::from), point.rgb);
        writeln!(out, "{id} {x} {y} {z} {r} {g} {b} 0")?;
    }
    Ok(())
}
