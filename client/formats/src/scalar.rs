//! Numbers in binary files.
//!
//! Invariant: any bytes are a number; a slice that is too short is read as if zeros followed, without a panic.

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are clear")]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// The byte order of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Endian {
    /// The least significant byte first.
    Little,
    /// The most significant byte first.
    Big,
}

impl Scalar {
    /// Length of a number.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Whether the type is an integer type.
    pub(crate) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The number that starts at an offset.
    #[allow(clippy::cast_precision_loss, reason = "coordinates beyond 2^53 do not exist")]
    pub(crate) fn read(self, bytes: &[u8], offset: usize, endian: Endian) -> f64 {
        let mut little = [0_u8; 8];
        for (to, &from) in little.iter_mut().zip(bytes.iter().skip(offset).take(self.bytes())) {
            *to = from;
        }
        if endian == Endian::Big {
            little[..self.bytes()].reverse();
        }
        let [a, b, c, d, ..] = little;
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([a])),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I64 => i64::from_le_bytes(little) as f64,
            Self::U64 => u64::from_le_bytes(little) as f64,
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(little),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_is_read_in_both_orders() {
        let cases: [(Scalar, &[u8], f64); 10] = [
            (Scalar::I8, &(-3_i8).to_le_bytes(), -3.0),
            (Scalar::U8, &200_u8.to_le_bytes(), 200.0),
            (Scalar::I16, &(-300_i16).to_le_bytes(), -300.0),
            (Scalar::U16, &60_000_u16.to_le_bytes(), 60_000.0),
            (Scalar::I32, &(-70_000_i32).to_le_bytes(), -70_000.0),
            (Scalar::U32, &4_000_000_000_u32.to_le_bytes(), 4e9),
            (Scalar::I64, &(-5_000_000_000_i64).to_le_bytes(), -5e9),
            (Scalar::U64, &5_000_000_000_u64.to_le_bytes(), 5e9),
            (Scalar::F32, &1.5_f32.to_le_bytes(), 1.5),
            (Scalar::F64, &(-0.1_f64).to_le_bytes(), -0.1),
        ];
        for (scalar, little, number) in cases {
            let padded: Vec<u8> = [&[7], little, &[9]].concat();
            assert_eq!(scalar.read(&padded, 1, Endian::Little), number, "{scalar:?}");
            let big: Vec<u8> = little.iter().rev().copied().collect();
            assert_eq!(scalar.read(&big, 0, Endian::Big), number, "{scalar:?}");
            assert_eq!(scalar.bytes(), little.len());
        }
        assert_eq!(Scalar::F64.read(&[1], 5, Endian::Big), 0.0, "too short, and yet no panic");
    }
}
