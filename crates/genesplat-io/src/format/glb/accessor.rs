//! Typed rows of the binary part of a `.glb`.

use super::schema::{Accessor, Document};

/// A component as glTF numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    F32,
}

impl Component {
    fn parse(component_type: u32) -> Option<Self> {
        Some(match component_type {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// The value, and what stands for 1 where values are normalised.
    fn value(self, bytes: &[u8]) -> (f32, f32) {
        match self {
            Self::I8 => (f32::from(bytes[0] as i8), 127.0),
            Self::U8 => (f32::from(bytes[0]), 255.0),
            Self::I16 => (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Self::U16 => (f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Self::F32 => (f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]), 1.0),
        }
    }
}

/// The rows of accessor `index`, of `K` components each, or what is wrong with them.
pub(super) fn rows<const K: usize>(
    document: &Document,
    binary: &[u8],
    index: usize,
) -> Result<Vec<[f32; K]>, String> {
    let accessor = document.accessors.get(index).ok_or_else(|| format!("refers to an accessor {index}"))?;
    let component = Component::parse(accessor.component_type)
        .ok_or_else(|| format!("has components of type {} in accessor {index}", accessor.component_type))?;
    let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][K - 1];
    if accessor.kind != kind {
        return Err(format!("has a {} in accessor {index}, where a {kind} belongs", accessor.kind));
    }
    if accessor.sparse.is_some() {
        return Err(format!("has a sparse accessor {index}, which genesplat does not read"));
    }
    let (bytes, stride) = bytes(document, binary, accessor, K * component.bytes())
        .ok_or_else(|| format!("ends before the {} rows of accessor {index}", accessor.count))?;
    let value = |bytes: &[u8]| match component.value(bytes) {
        (value, one) if accessor.normalized => (value / one).max(-1.0),
        (value, _) => value,
    };
    let row = |row: usize| std::array::from_fn(|k| value(&bytes[row * stride + k * component.bytes()..]));
    Ok((0..accessor.count).map(row).collect())
}

/// The bytes of an accessor from its first row, and the distance of its rows; `None` where they are not all
/// there.
fn bytes<'a>(
    document: &Document,
    binary: &'a [u8],
    accessor: &Accessor,
    row_bytes: usize,
) -> Option<(&'a [u8], usize)> {
    let view = document.buffer_views.get(accessor.buffer_view?).filter(|view| view.buffer == 0)?;
    let end = view.byte_offset.checked_add(view.byte_length)?;
    let bytes = binary.get(view.byte_offset..end)?.get(accessor.byte_offset..)?;
    let stride = view.byte_stride.unwrap_or(row_bytes).max(row_bytes);
    // The last row need not be followed by a gap.
    let needed = match accessor.count.checked_sub(1) {
        None => 0,
        Some(others) => others.checked_mul(stride)?.checked_add(row_bytes)?,
    };
    (bytes.len() >= needed).then_some((bytes, stride))
}
