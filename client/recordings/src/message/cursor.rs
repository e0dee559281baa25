//! A place in the bytes of a message, and how primitive values are laid out there.
//!
//! Invariant: nothing is read behind the end, and no length is trusted before the bytes are there.

use super::{MessageError, Numbers, VALUES_MAX, Value};
use crate::definition::Primitive;

/// A place in a message.
pub(super) struct MessageCursor<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The position from which alignment counts, and the largest alignment; `None`: values are packed, as in ROS 1.
    alignment: Option<(usize, usize)>,
    is_big_endian: bool,
    values: usize,
    wide: WideForm,
}

/// How wide text is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum WideForm {
    /// The number of letters, then each in four bytes.
    #[default]
    FourBytes,
    /// The number of letters, then each in two bytes.
    TwoBytes,
    /// The number of bytes, then each letter in two of them.
    TwoBytesCounted,
}

impl<'a> MessageCursor<'a> {
    pub(super) fn ros1(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, alignment: None, is_big_endian: false, values: 0, wide: WideForm::default() }
    }

    pub(super) fn cdr(bytes: &'a [u8]) -> Result<Self, MessageError> {
        let [first, second, _, _, ..] = *bytes else {
            return Err(MessageError::Short { bytes: bytes.len(), field: "the header of CDR".to_owned() });
        };
        // Plain CDR aligns to 8 bytes at most, the second version of XCDR to 4.
        let (is_big_endian, largest) = match (first, second) {
            (0, 0) => (true, 8),
            (0, 1) => (false, 8),
            (0, 6) => (true, 4),
            (0, 7) => (false, 4),
            _ => return Err(MessageError::Representation([first, second])),
        };
        Ok(Self { bytes, at: 4, alignment: Some((4, largest)), is_big_endian, values: 0, wide: WideForm::default() })
    }

    pub(super) fn with_wide(self, wide: WideForm) -> Self {
        Self { wide, ..self }
    }

    /// Whether no more than padding is left.
    pub(super) fn is_at_end(&self) -> bool {
        self.bytes.len() - self.at < 4
    }

    /// A structure without fields takes one byte in CDR.
    pub(super) fn empty_structure(&mut self) {
        if self.alignment.is_some() {
            self.at = self.at.saturating_add(1);
        }
    }

    pub(super) fn count_value(&mut self) -> Result<(), MessageError> {
        self.values += 1;
        if self.values > VALUES_MAX { Err(MessageError::TooManyValues) } else { Ok(()) }
    }

    /// The number of values of an array, or of bytes of text.
    pub(super) fn length(&mut self, field: &str) -> Result<usize, MessageError> {
        let bytes = self.aligned(4, 4, field)?;
        let length = number(Primitive::Uint32, bytes, self.is_big_endian).integer().unwrap_or_default();
        usize::try_from(length).map_err(|_| self.short(field))
    }

    pub(super) fn numbers(
        &mut self,
        primitive: Primitive,
        count: usize,
        field: &str,
    ) -> Result<Numbers<'a>, MessageError> {
        let size = primitive.bytes().unwrap_or(1);
        // No padding comes before an array without elements.
        let alignment = if count == 0 { 1 } else { size };
        let total = count.checked_mul(size).ok_or_else(|| self.short(field))?;
        let bytes = self.aligned(alignment, total, field)?;
        Ok(Numbers { primitive, bytes, is_big_endian: self.is_big_endian })
    }

    pub(super) fn primitive(&mut self, primitive: Primitive, field: &str) -> Result<Value<'a>, MessageError> {
        match primitive {
            Primitive::Text => {
                let length = self.length(field)?;
                let bytes = self.aligned(1, length, field)?;
                // CDR ends text with a zero byte, ROS 1 does not.
                let text = if self.alignment.is_some() { bytes.strip_suffix(&[0]).unwrap_or(bytes) } else { bytes };
                Ok(Value::Text(text))
            }
            Primitive::WideText => {
                let length = self.length(field)?;
                let (primitive, count) = match self.wide {
                    WideForm::FourBytes => (Primitive::Uint32, length),
                    WideForm::TwoBytes => (Primitive::Uint16, length),
                    WideForm::TwoBytesCounted => (Primitive::Uint16, length / 2),
                };
                self.numbers(primitive, count, field).map(Value::WideText)
            }
            Primitive::Time | Primitive::Duration => {
                let half = if primitive == Primitive::Time { Primitive::Uint32 } else { Primitive::Int32 };
                let seconds = self.integer(half, field)?;
                let nanos = self.integer(half, field)?;
                // Two numbers of 32 bits as seconds and nanoseconds always fit into 64.
                Ok(Value::Nanos(i64::try_from(seconds * 1_000_000_000 + nanos).unwrap_or(i64::MAX)))
            }
            _ => {
                let size = primitive.bytes().unwrap_or(1);
                let bytes = self.aligned(size, size, field)?;
                Ok(number(primitive, bytes, self.is_big_endian))
            }
        }
    }

    fn integer(&mut self, primitive: Primitive, field: &str) -> Result<i128, MessageError> {
        let bytes = self.aligned(4, 4, field)?;
        Ok(number(primitive, bytes, self.is_big_endian).integer().unwrap_or_default())
    }

    /// The next bytes, behind the padding that aligns them.
    fn aligned(&mut self, alignment: usize, count: usize, field: &str) -> Result<&'a [u8], MessageError> {
        let padding = self.alignment.map_or(0, |(from, largest)| {
            let alignment = alignment.clamp(1, largest);
            (alignment - (self.at - from) % alignment) % alignment
        });
        let bytes = self
            .at
            .checked_add(padding)
            .and_then(|start| Some(start..start.checked_add(count)?))
            .and_then(|range| self.bytes.get(range))
            .ok_or_else(|| self.short(field))?;
        self.at += padding + count;
        Ok(bytes)
    }

    fn short(&self, field: &str) -> MessageError {
        MessageError::Short { bytes: self.bytes.len(), field: field.to_owned() }
    }
}

/// The number that the bytes encode; 0 if their count is not the size of the type.
pub(crate) fn number<'a>(primitive: Primitive, bytes: &[u8], is_big_endian: bool) -> Value<'a> {
    macro_rules! read {
        ($type:ty) => {{
            let bytes = bytes.try_into().unwrap_or_default();
            if is_big_endian { <$type>::from_be_bytes(bytes) } else { <$type>::from_le_bytes(bytes) }
        }};
    }
    match primitive {
        Primitive::Bool => Value::Bool(bytes.first().is_some_and(|byte| *byte != 0)),
        Primitive::Int8 => Value::Integer(read!(i8).into()),
        Primitive::Uint8 => Value::Integer(read!(u8).into()),
        Primitive::Int16 => Value::Integer(read!(i16).into()),
        Primitive::Uint16 => Value::Integer(read!(u16).into()),
        Primitive::Int32 => Value::Integer(read!(i32).into()),
        Primitive::Uint32 => Value::Integer(read!(u32).into()),
        Primitive::Int64 => Value::Integer(read!(i64).into()),
        Primitive::Uint64 => Value::Integer(read!(u64).into()),
        Primitive::Float32 => Value::Float(read!(f32).into()),
        Primitive::Float64 => Value::Float(read!(f64)),
        Primitive::Text | Primitive::WideText | Primitive::Time | Primitive::Duration => Value::Nanos(0),
    }
}
