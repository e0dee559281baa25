//! The map that a request names, read from its bytes.
//!
//! Invariant: the result equals that of decoding the message. A message that cannot be decoded, or that is compressed,
//! names no map.

use std::{collections::HashMap, sync::LazyLock};

use prost::{
    Message as _,
    bytes::Buf as _,
    encoding::{WireType, decode_key, decode_varint},
};
use prost_types::{DescriptorProto, FileDescriptorSet};

use crate::v1::DESCRIPTORS;

/// The field in which the requests of a method name their map.
#[derive(Debug, PartialEq, Eq)]
enum MapField {
    /// In a field of the request.
    Direct(u32),
    /// In a field of the first message, which is one of several kinds.
    Nested {
        /// The field that holds the message.
        message: u32,
        /// All fields that may take the place of this message.
        choices: Vec<u32>,
        /// The field in the message.
        field: u32,
    },
}

/// The request that names a map in the field `name`.
const NAMED: &str = "GetMapRequest";

/// The fields by path of the method.
static FIELDS: LazyLock<HashMap<String, MapField>> = LazyLock::new(fields);

fn fields() -> HashMap<String, MapField> {
    let set = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
    let mut messages: HashMap<String, &DescriptorProto> = HashMap::new();
    for file in &set.file {
        messages.extend(file.message_type.iter().map(|it| (format!(".{}.{}", file.package(), it.name()), it)));
    }
    let mut found = HashMap::new();
    for file in &set.file {
        for service in &file.service {
            for method in &service.method {
                let request = messages.get(method.input_type());
                let field = request.and_then(|request| match map_field(request) {
                    Some(number) => Some(MapField::Direct(number)),
                    None if method.client_streaming() => nested(request, &messages),
                    None => None,
                });
                if let Some(field) = field {
                    found.insert(format!("/{}.{}/{}", file.package(), service.name(), method.name()), field);
                }
            }
        }
    }
    found
}

/// The number of the field with the name of a map.
fn map_field(message: &DescriptorProto) -> Option<u32> {
    let name = if message.name() == NAMED { "name" } else { "map" };
    message.field.iter().find(|field| field.name() == name).map(|field| field.number().unsigned_abs())
}

fn nested(request: &DescriptorProto, messages: &HashMap<String, &DescriptorProto>) -> Option<MapField> {
    let choices = || request.field.iter().filter(|field| field.oneof_index.is_some());
    choices().find_map(|choice| {
        Some(MapField::Nested {
            field: map_field(messages.get(choice.type_name())?)?,
            message: choice.number().unsigned_abs(),
            choices: choices().map(|other| other.number().unsigned_abs()).collect(),
        })
    })
}

/// Whether the requests of a method name a map, or the first one of a stream.
#[must_use]
pub fn names_a_map(path: &str) -> bool {
    FIELDS.contains_key(path)
}

/// The map that a message of a method names; `None`: none, or it cannot be decoded.
#[must_use]
pub fn map_of<'a>(path: &str, message: &'a [u8]) -> Option<&'a str> {
    let named = match FIELDS.get(path)? {
        MapField::Direct(field) => last(message, *field)?,
        MapField::Nested { message: number, choices, field } => {
            let (mut named, mut rest) = (None, message);
            while !rest.is_empty() {
                match next(&mut rest)? {
                    // Parts of one message are merged.
                    (found, Some(part)) if found == *number => named = last(part, *field)?.or(named),
                    (found, _) if choices.contains(&found) => named = None,
                    _ => {}
                }
            }
            named
        }
    };
    std::str::from_utf8(named?).ok().filter(|map| !map.is_empty())
}

/// The last value of a field of a message, which is the one that counts. The outer `None`: it is no message.
#[expect(clippy::option_option, reason = "no message, and no such field")]
fn last(mut message: &[u8], number: u32) -> Option<Option<&[u8]>> {
    let mut value = None;
    while !message.is_empty() {
        match next(&mut message)? {
            (found, Some(payload)) if found == number => value = Some(payload),
            (found, None) if found == number => return None,
            _ => {}
        }
    }
    Some(value)
}

/// The number of the next field, and its bytes if they are delimited. `None`: this is no message.
fn next<'a>(bytes: &mut &'a [u8]) -> Option<(u32, Option<&'a [u8]>)> {
    let (number, wire_type) = decode_key(bytes).ok()?;
    let width = match wire_type {
        WireType::Varint => {
            decode_varint(bytes).ok()?;
            0
        }
        WireType::LengthDelimited => {
            let length = usize::try_from(decode_varint(bytes).ok()?).ok()?;
            let (payload, rest) = bytes.split_at_checked(length)?;
            *bytes = rest;
            return Some((number, Some(payload)));
        }
        WireType::SixtyFourBit => 8,
        WireType::ThirtyTwoBit => 4,
        // Groups, which no message of this package has.
        _ => return None,
    };
    if bytes.len() < width {
        return None;
    }
    bytes.advance(width);
    Some((number, None))
}

#[cfg(test)]
mod tests;
