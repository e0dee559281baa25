//! Messages in JSON and protobuf, brought into the layout of ROS 1: the rest of the crate reads one form of bytes.
//!
//! Invariant: a shape is finite. It leaves out maps and types that contain themselves; no layout names these, so that a
//! mapping that names them is refused.

mod json;
mod protobuf;

use std::sync::Arc;

use prost_reflect::MessageDescriptor;

use crate::{
    definition::{Constant, Count, Primitive},
    layout::{Kind, LaidField, Structure},
    recording::Encoding,
};

/// Maximum depth of objects within objects.
const DEPTH_MAX: usize = 32;
/// Maximum number of fields of a shape, the fields of the objects inside included.
const FIELDS_MAX: usize = 10_000;
/// Field of the elements of a list that lies directly within a list.
const ELEMENTS: &str = "elements";

/// The kind of a value.
#[derive(Clone, Debug, PartialEq)]
enum ValueShape {
    Bool,
    Integer,
    Unsigned,
    Float,
    Text,
    Bytes,
    Time,
    Duration,
    List(Box<ValueShape>),
    Object(Arc<Object>),
}

/// The fields of an object.
#[derive(Debug, Default, PartialEq)]
struct Object {
    type_name: String,
    fields: Vec<ForeignField>,
    constants: Vec<Constant>,
}

#[derive(Debug, PartialEq)]
struct ForeignField {
    /// The name in the messages.
    key: String,
    shape: ValueShape,
}

impl ValueShape {
    fn kind(&self) -> (Kind, Count) {
        let primitive = match self {
            Self::Bool => Primitive::Bool,
            Self::Integer => Primitive::Int64,
            Self::Unsigned => Primitive::Uint64,
            Self::Float => Primitive::Float64,
            Self::Text => Primitive::Text,
            Self::Time => Primitive::Time,
            Self::Duration => Primitive::Duration,
            Self::Bytes => return (Kind::Primitive(Primitive::Uint8), Count::Any),
            Self::Object(object) => return (Kind::Structure(object.structure()), Count::One),
            Self::List(inner) => return (inner.kind().0, Count::Any),
        };
        (Kind::Primitive(primitive), Count::One)
    }

    /// A list of these. A list has no lists as elements: each becomes an object.
    fn listed(self) -> Self {
        match self {
            shape @ (Self::List(_) | Self::Bytes) => {
                let fields = vec![ForeignField { key: ELEMENTS.to_owned(), shape }];
                let object = Object { type_name: ELEMENTS.to_owned(), fields, constants: Vec::new() };
                Self::List(Box::new(Self::Object(Arc::new(object))))
            }
            shape => Self::List(Box::new(shape)),
        }
    }
}

impl Object {
    fn structure(&self) -> Arc<Structure> {
        let fields = self.fields.iter().map(|field| {
            let (kind, count) = field.shape.kind();
            LaidField { name: named(&field.key), kind, count }
        });
        let (type_name, constants) = (self.type_name.clone(), self.constants.clone());
        Arc::new(Structure { type_name, fields: fields.collect(), constants })
    }
}

/// A key as the name of a field: paths separate names by points.
fn named(key: &str) -> String {
    key.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '_' }).collect()
}

/// Writes values in the layout of ROS 1.
#[derive(Debug)]
struct Writer<'o>(&'o mut Vec<u8>);

impl Writer<'_> {
    fn count(&mut self, count: usize) -> Result<(), String> {
        let count = u32::try_from(count).map_err(|_| format!("a list of {count} elements is too long"))?;
        self.0.extend(count.to_le_bytes());
        Ok(())
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.count(bytes.len())?;
        self.0.extend(bytes);
        Ok(())
    }

    fn integer(&mut self, value: i64) {
        self.0.extend(value.to_le_bytes());
    }

    fn unsigned(&mut self, value: u64) {
        self.0.extend(value.to_le_bytes());
    }

    fn float(&mut self, value: f64) {
        self.0.extend(value.to_le_bytes());
    }

    fn time(&mut self, seconds: i64, nanos: i64) -> Result<(), String> {
        let part = |part: i64| u32::try_from(part).map(u32::to_le_bytes);
        let (Ok(seconds), Ok(nanos)) = (part(seconds), part(nanos)) else {
            return Err(format!("the time {seconds} s and {nanos} ns is before 1970 or after 2106"));
        };
        self.0.extend([seconds, nanos].concat());
        Ok(())
    }

    fn duration(&mut self, seconds: i64, nanos: i64) -> Result<(), String> {
        let part = |part: i64| i32::try_from(part).map(i32::to_le_bytes);
        let (Ok(seconds), Ok(nanos)) = (part(seconds), part(nanos)) else {
            return Err(format!("the duration {seconds} s and {nanos} ns is longer than 68 years"));
        };
        self.0.extend([seconds, nanos].concat());
        Ok(())
    }
}

/// Brings the messages of a topic into the layout of ROS 1.
#[derive(Clone, Debug)]
pub(crate) struct Translator {
    object: Arc<Object>,
    language: Language,
}

#[derive(Clone, Debug)]
enum Language {
    Json,
    Protobuf(MessageDescriptor),
}

impl Translator {
    /// Reads the schema of a topic; absent if its messages are not of a language that is translated.
    pub(crate) fn of_topic(type_name: &str, encoding: &Encoding) -> Option<Result<Self, String>> {
        match encoding {
            Encoding::Json(schema) => {
                Some(json::object(type_name, schema).map(|object| Self { object, language: Language::Json }))
            }
            Encoding::Protobuf(schema) => Some(
                protobuf::object(type_name, schema)
                    .map(|(object, descriptor)| Self { object, language: Language::Protobuf(descriptor) }),
            ),
            Encoding::Ros1 | Encoding::Cdr | Encoding::Other(_) | Encoding::Unreadable(_) => None,
        }
    }

    /// The layout of the translated messages.
    pub(crate) fn layout(&self) -> Arc<Structure> {
        self.object.structure()
    }

    /// Translates a message.
    ///
    /// # Errors
    /// The message is not of its language, or does not fit its schema; in words.
    pub(crate) fn translate(&self, message: &[u8], into: &mut Vec<u8>) -> Result<(), String> {
        into.clear();
        match &self.language {
            Language::Json => json::write(&self.object, message, &mut Writer(into)),
            Language::Protobuf(descriptor) => {
                protobuf::write(&self.object, descriptor.clone(), message, &mut Writer(into))
            }
        }
    }
}
