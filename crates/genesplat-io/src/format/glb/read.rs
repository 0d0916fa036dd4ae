//! Splats out of a `.glb`: all primitives with the extension, in the order of the file.

use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_core::spherical_harmonics::SH_STRIDE;
use serde_json::Value;

use super::accessor::rows;
use super::nodes::check_in_place;
use super::schema::{Document, Primitive};
use super::{
    BINARY_CHUNK, COLOUR_SPACE, EXTENSION, JSON_CHUNK, KERNEL, MAGIC, OPACITY, ORDERS, POSITION, ROTATION,
    SCALE, VERSION, harmonic,
};
use crate::format::packing::{half_turn_about_x, log_scale, opacity_logit, word};
use crate::format::{Decoded, FormatError, check_claim, ensure_memory};

pub(in crate::format) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, FormatError> {
    let damaged = |problem: String| FormatError::damaged(path, problem);
    let (json, binary) = chunks(bytes).map_err(damaged)?;
    let document: Document = serde_json::from_slice(json)
        .map_err(|error| damaged(format!("has a description that is not valid ({error})")))?;
    let is_splat = |primitive: &&Primitive| primitive.extensions.contains_key(EXTENSION);
    let meshes: Vec<usize> = (document.meshes.iter().enumerate())
        .filter_map(|(index, mesh)| {
            mesh.primitives.iter().any(|primitive| is_splat(&primitive)).then_some(index)
        })
        .collect();
    check_in_place(&document, &meshes).map_err(|problem| FormatError::unsupported(path, problem))?;
    let mut cloud = Gaussians::default();
    let mut sh_degree = 0;
    let accessors = document.accessors.iter();
    let most = accessors.map(|accessor| accessor.count).max().unwrap_or(0).min(bytes.len());
    for primitive in document.meshes.iter().flat_map(|mesh| &mesh.primitives).filter(is_splat) {
        check_supported(&primitive.extensions[EXTENSION])
            .map_err(|problem| FormatError::unsupported(path, problem))?;
        // Of what there is, a part is moved to make room.
        ensure_memory(path, 2, cloud.len() + most)?;
        let degree = append(&mut cloud, &document, binary, primitive).map_err(damaged)?;
        sh_degree = degree.max(sh_degree);
        // Primitives may share their bytes.
        check_claim(path, cloud.len() as u64, bytes.len())?;
    }
    if cloud.is_empty() {
        let problem = format!("holds no splat: no mesh in it uses {EXTENSION}; give a file that does");
        return Err(FormatError::unsupported(path, problem));
    }
    half_turn_about_x(&mut cloud);
    Ok(Decoded { cloud, sh_degree, screen_filter: None, is_2dgs: false, offset: None })
}

/// The JSON and the binary part.
fn chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let (header, mut rest) = bytes.split_first_chunk::<12>().ok_or("ends within its header")?;
    let (version, length) = (word(header, 4), word(header, 8));
    if !header.starts_with(&MAGIC) || version != VERSION {
        return Err(format!("is no .glb of version {VERSION}"));
    }
    if length as usize != bytes.len() {
        return Err(format!("says that it has {length} bytes, and has {}", bytes.len()));
    }
    let (mut json, mut binary): (Option<&[u8]>, &[u8]) = (None, &[]);
    while let Some((start, following)) = rest.split_first_chunk::<8>() {
        let size = word(start, 0) as usize;
        let (chunk, following) = following.split_at_checked(size).ok_or("ends within a chunk")?;
        match start[4..8].try_into().unwrap_or_default() {
            JSON_CHUNK => json = json.or(Some(chunk)),
            BINARY_CHUNK if binary.is_empty() => binary = chunk,
            _ => {}
        }
        rest = following;
    }
    if rest.is_empty() {
        json.map(|json| (json, binary)).ok_or("has no description".into())
    } else {
        Err("ends within a chunk".into())
    }
}

/// What changes the meaning of the attributes is refused.
fn check_supported(extension: &Value) -> Result<(), String> {
    let is = |name: &str, known: &str| {
        extension.get(name).and_then(Value::as_str).is_none_or(|value| value == known)
    };
    if !is("kernel", KERNEL) {
        return Err(format!(
            "uses the kernel {}, and genesplat reads {KERNEL}; export it with that",
            extension["kernel"]
        ));
    }
    if !is("colorSpace", COLOUR_SPACE) {
        let space = &extension["colorSpace"];
        return Err(format!(
            "has colours in {space}, and genesplat reads {COLOUR_SPACE}; export it with that"
        ));
    }
    if extension.get("extensions").and_then(Value::as_object).is_some_and(|inner| !inner.is_empty()) {
        return Err(
            "is compressed within glTF, which genesplat does not read; export it without, or as .spz".into(),
        );
    }
    Ok(())
}

/// Appends the Gaussians of a primitive; returns the degree of their harmonics.
fn append(
    cloud: &mut Gaussians,
    document: &Document,
    binary: &[u8],
    primitive: &Primitive,
) -> Result<u8, String> {
    let index = |name: &str| primitive.attributes.get(name).copied();
    let needed = |name: &str| index(name).ok_or_else(|| format!("has a splat without {name}"));
    let positions: Vec<[f32; 3]> = rows(document, binary, needed(POSITION)?)?;
    let rotations: Vec<[f32; 4]> = rows(document, binary, needed(ROTATION)?)?;
    let scales: Vec<[f32; 3]> = rows(document, binary, needed(SCALE)?)?;
    let opacities: Vec<[f32; 1]> = rows(document, binary, needed(OPACITY)?)?;
    let count = positions.len();
    if [rotations.len(), scales.len(), opacities.len()] != [count; 3] {
        return Err(format!("has {count} positions, and another number of rotations, scales or opacities"));
    }
    let first = cloud.len();
    cloud.positions.extend(positions);
    cloud.rotations.extend(rotations.into_iter().map(|[x, y, z, w]| [w, x, y, z]));
    cloud.log_scales.extend(scales.into_iter().map(|scale| scale.map(log_scale)));
    cloud.opacity_logits.extend(opacities.into_iter().map(|[opacity]| opacity_logit(opacity)));
    cloud.sh.resize(first + count, [0.0; SH_STRIDE]);
    needed(&harmonic(0, 0))?;
    let mut slot = 0;
    for (degree, orders) in ORDERS.into_iter().enumerate() {
        for n in 0..orders {
            let Some(index) = index(&harmonic(degree, n)) else {
                let whole = degree.saturating_sub(1) as u8;
                return if n == 0 {
                    Ok(whole)
                } else {
                    Err(format!("has only some harmonics of degree {degree}"))
                };
            };
            let values: Vec<[f32; 3]> = rows(document, binary, index)?;
            if values.len() != count {
                return Err(format!(
                    "has {count} positions, and {} values of {}",
                    values.len(),
                    harmonic(degree, n)
                ));
            }
            for (row, value) in cloud.sh[first..].iter_mut().zip(values) {
                row[slot..slot + 3].copy_from_slice(&value);
            }
            slot += 3;
        }
    }
    Ok(3)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_would_be_read_wrongly_is_refused() {
        assert_eq!(
            check_supported(&json!({"kernel": KERNEL, "colorSpace": COLOUR_SPACE, "extensions": {}})),
            Ok(())
        );
        for (extension, word) in [
            (json!({"kernel": "box"}), "box"),
            (json!({"kernel": KERNEL, "colorSpace": "lin_rec709_display"}), "lin_rec709_display"),
            (
                json!({"kernel": KERNEL, "extensions": {"KHR_gaussian_splatting_compression_spz_2": {}}}),
                "compressed",
            ),
        ] {
            let problem = check_supported(&extension).unwrap_err();
            assert!(problem.contains(word) && problem.contains("export"), "{problem}");
        }
    }
}
