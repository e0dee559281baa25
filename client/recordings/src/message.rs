//! Values of messages, by their layout: bytes of ROS 1 or CDR in, a tree of values out.
//!
//! Invariant: reading is bounded: arrays of numbers stay the bytes that they are, and the number of all other values of
//! a message is limited. Bytes behind the last field are ignored, as ROS does.

mod cursor;
mod path;

use std::sync::Arc;

pub use self::path::{Path, PathError};

pub(crate) use self::cursor::number;
use self::cursor::{MessageCursor, WideForm};
use crate::{
    definition::{Count, Primitive},
    layout::{Kind, LaidField, Structure},
    recording::Encoding,
};

/// Maximum number of values of a message, each array of numbers counting as one.
pub const VALUES_MAX: usize = 500_000;

/// Why a message cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MessageError {
    /// The bytes end before the last field.
    #[error("the message ends after {bytes} bytes, within {field}")]
    Short {
        /// Number of bytes of the message.
        bytes: usize,
        /// The field that is not whole.
        field: String,
    },
    /// More values than are read.
    #[error("the message has more than {VALUES_MAX} values")]
    TooManyValues,
    /// The first bytes name an encoding that is not read.
    #[error("the message begins with {0:02x?}, which is no plain CDR")]
    Representation([u8; 2]),
    /// Wide text is in a form that is not known.
    #[error("its wide text (wstring) is in a form that is not known")]
    Wide,
    /// The encoding is none that is read.
    #[error("the encoding {0:?} is not read")]
    Encoding(String),
}

/// A value of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Value<'a> {
    /// True or false.
    Bool(bool),
    /// An integer.
    Integer(i128),
    /// A number with a fraction.
    Float(f64),
    /// Text, as its bytes: they need not be UTF-8.
    Text(&'a [u8]),
    /// Text of wide letters: the numbers of UTF-16, or of its letters.
    WideText(Numbers<'a>),
    /// A time or a duration of ROS 1, nanoseconds.
    Nanos(i64),
    /// An array of numbers.
    Numbers(Numbers<'a>),
    /// An array of other values.
    List(Vec<Value<'a>>),
    /// A value with fields, in the order of its layout.
    Structure(Arc<Structure>, Vec<Value<'a>>),
}

/// An array of numbers, as its bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers<'a> {
    /// Type of the numbers; neither text nor time.
    pub primitive: Primitive,
    /// The bytes of the numbers, whole numbers of them.
    pub bytes: &'a [u8],
    /// Whether the most significant byte comes first.
    pub is_big_endian: bool,
}

impl<'a> Numbers<'a> {
    /// The number of numbers.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.primitive.bytes().unwrap_or(1)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The number at an index.
    pub fn get(&self, index: usize) -> Option<Value<'a>> {
        let size = self.primitive.bytes()?;
        let start = index.checked_mul(size)?;
        let bytes = self.bytes.get(start..start.checked_add(size)?)?;
        Some(cursor::number(self.primitive, bytes, self.is_big_endian))
    }

    /// The numbers, as floating point.
    pub fn floats(&self) -> impl Iterator<Item = f64> + 'a {
        let (primitive, is_big_endian) = (self.primitive, self.is_big_endian);
        let size = primitive.bytes().unwrap_or(1);
        self.bytes
            .chunks_exact(size)
            .map(move |bytes| cursor::number(primitive, bytes, is_big_endian).number().unwrap_or(f64::NAN))
    }
}

impl<'a> Value<'a> {
    /// The value as a number; true is 1.
    pub fn number(&self) -> Option<f64> {
        match self {
            Value::Bool(value) => Some(f64::from(u8::from(*value))),
            Value::Integer(value) => Some(*value as f64),
            Value::Float(value) => Some(*value),
            _ => None,
        }
    }

    /// The value as an integer.
    pub fn integer(&self) -> Option<i128> {
        match self {
            Value::Bool(value) => Some(i128::from(*value)),
            Value::Integer(value) => Some(*value),
            _ => None,
        }
    }

    /// The value as text; bytes that are no UTF-8 become the replacement character.
    pub fn text(&self) -> Option<String> {
        match self {
            Value::Text(bytes) => Some(String::from_utf8_lossy(bytes).into_owned()),
            Value::WideText(numbers) => {
                // Letters above 65,535 are single numbers where each has four bytes, and pairs where it has two.
                let units = numbers.floats().flat_map(|number| {
                    let letter = char::from_u32(number as u32).filter(|letter| u32::from(*letter) > 0xFFFF);
                    let mut pair = [0; 2];
                    match letter {
                        Some(letter) => letter.encode_utf16(&mut pair).to_vec(),
                        None => vec![number as u16],
                    }
                });
                Some(char::decode_utf16(units).map(|letter| letter.unwrap_or('\u{FFFD}')).collect())
            }
            _ => None,
        }
    }

    /// The value as an array of numbers.
    pub fn numbers(&self) -> Option<Numbers<'a>> {
        match self {
            Value::Numbers(numbers) => Some(*numbers),
            _ => None,
        }
    }

    /// The elements of an array of values with fields or of text.
    pub fn list(&self) -> Option<&[Value<'a>]> {
        match self {
            Value::List(values) => Some(values),
            _ => None,
        }
    }

    /// A time of ROS 1, or the seconds and nanoseconds of ROS 2. Nanoseconds since 1970; `None` if the value is no time
    /// or out of range.
    pub fn time_nanos(&self) -> Option<i64> {
        match self {
            Value::Nanos(nanos) => Some(*nanos),
            Value::Structure(..) => {
                let seconds = self.field("sec")?.integer()?;
                let nanos = self.field("nanosec")?.integer()?;
                i64::try_from(seconds.checked_mul(1_000_000_000)?.checked_add(nanos)?).ok()
            }
            _ => None,
        }
    }

    /// The field of a name.
    pub fn field(&self, name: &str) -> Option<&Value<'a>> {
        let Value::Structure(structure, values) = self else { return None };
        let index = structure.fields.iter().position(|field| field.name == name)?;
        values.get(index)
    }

    /// The field at the end of names, from the outermost on.
    pub fn at(&self, names: &[&str]) -> Option<&Value<'a>> {
        names.iter().try_fold(self, |value, name| value.field(name))
    }
}

/// Reads a message.
///
/// # Errors
/// The bytes end early, hold too many values, or are of an encoding that is not read.
pub fn read<'a>(layout: &Arc<Structure>, encoding: &Encoding, bytes: &'a [u8]) -> Result<Value<'a>, MessageError> {
    if *encoding == Encoding::Cdr && has_wide_text(layout) {
        return read_wide(layout, bytes);
    }
    let mut cursor = match encoding {
        Encoding::Ros1 => MessageCursor::ros1(bytes),
        Encoding::Cdr => MessageCursor::cdr(bytes)?,
        // These are brought into the layout of ROS 1 before.
        Encoding::Json(_) => return Err(MessageError::Encoding("json".to_owned())),
        Encoding::Protobuf(_) => return Err(MessageError::Encoding("protobuf".to_owned())),
        Encoding::Other(name) | Encoding::Unreadable(name) => return Err(MessageError::Encoding(name.clone())),
    };
    structure(layout, &mut cursor)
}

/// Whether a type has fields of wide text.
fn has_wide_text(layout: &Structure) -> bool {
    layout.fields.iter().any(|field| match &field.kind {
        Kind::Primitive(primitive) => *primitive == Primitive::WideText,
        Kind::Structure(inner) => has_wide_text(inner),
    })
}

/// Reads a message with wide text, whose bytes no standard fixes: ROS 2 writes the number of letters and each letter in
/// four bytes; others write two bytes a letter, and the number of letters or of bytes. The form is the one by which the
/// fields end where the message ends.
fn read_wide<'a>(layout: &Arc<Structure>, bytes: &'a [u8]) -> Result<Value<'a>, MessageError> {
    let mut first = None;
    for form in [WideForm::FourBytes, WideForm::TwoBytes, WideForm::TwoBytesCounted] {
        let mut cursor = MessageCursor::cdr(bytes)?.with_wide(form);
        match structure(layout, &mut cursor) {
            Ok(value) if cursor.is_at_end() => return Ok(value),
            Ok(_) => {
                first.get_or_insert(MessageError::Wide);
            }
            Err(error) => {
                first.get_or_insert(error);
            }
        }
    }
    Err(first.unwrap_or(MessageError::Wide))
}

fn structure<'a>(layout: &Arc<Structure>, cursor: &mut MessageCursor<'a>) -> Result<Value<'a>, MessageError> {
    if layout.fields.is_empty() {
        cursor.empty_structure();
    }
    let mut values = Vec::with_capacity(layout.fields.len());
    for laid in &layout.fields {
        values.push(field(laid, cursor)?);
    }
    Ok(Value::Structure(layout.clone(), values))
}

fn field<'a>(laid: &LaidField, cursor: &mut MessageCursor<'a>) -> Result<Value<'a>, MessageError> {
    cursor.count_value()?;
    let count = match laid.count {
        Count::One => return one(laid, cursor),
        Count::Fixed(count) => count,
        Count::Any => cursor.length(&laid.name)?,
    };
    match &laid.kind {
        Kind::Primitive(primitive)
            if primitive.bytes().is_some() && !matches!(primitive, Primitive::Time | Primitive::Duration) =>
        {
            cursor.numbers(*primitive, count, &laid.name).map(Value::Numbers)
        }
        _ => {
            let mut values = Vec::new();
            for _ in 0..count {
                cursor.count_value()?;
                values.push(one(laid, cursor)?);
            }
            Ok(Value::List(values))
        }
    }
}

fn one<'a>(laid: &LaidField, cursor: &mut MessageCursor<'a>) -> Result<Value<'a>, MessageError> {
    match &laid.kind {
        Kind::Primitive(primitive) => cursor.primitive(*primitive, &laid.name),
        Kind::Structure(inner) => structure(inner, cursor),
    }
}

#[cfg(test)]
mod tests;
