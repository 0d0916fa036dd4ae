//! One value of a row: its type, its place, and how it is read as `f32`.

/// A value that the header declares.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property {
    /// As the header spells it.
    pub(super) name: String,
    pub(super) field: Field,
}

/// Where a value lies in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) scalar: Scalar,
    /// Bytes from the start of the row.
    pub(super) offset: usize,
    /// Its highest byte comes first.
    pub(super) is_big_endian: bool,
}

impl Field {
    pub(super) fn value(self, row: &[u8]) -> f32 {
        match self.scalar {
            Scalar::F32 => f32::from_le_bytes(self.bytes(row)),
            Scalar::F64 => f64::from_le_bytes(self.bytes(row)) as f32,
            Scalar::I8 => f32::from(row[self.offset] as i8),
            Scalar::U8 => f32::from(row[self.offset]),
            Scalar::I16 => f32::from(i16::from_le_bytes(self.bytes(row))),
            Scalar::U16 => f32::from(u16::from_le_bytes(self.bytes(row))),
            Scalar::I32 => i32::from_le_bytes(self.bytes(row)) as f32,
            Scalar::U32 => u32::from_le_bytes(self.bytes(row)) as f32,
        }
    }

    /// Its bytes, the lowest first.
    fn bytes<const K: usize>(self, row: &[u8]) -> [u8; K] {
        let mut bytes: [u8; K] = std::array::from_fn(|i| row[self.offset + i]);
        if self.is_big_endian {
            bytes.reverse();
        }
        bytes
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// The type that a header calls `name`.
    pub(super) fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}
