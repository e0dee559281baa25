//! Messages of protobuf, by the descriptors that a recording holds.
//!
//! Invariant: fields that a message does not set have their default, as protobuf has it.

use std::sync::Arc;

use prost_reflect::{DescriptorPool, DynamicMessage, Kind, MessageDescriptor, Value};

use super::{DEPTH_MAX, FIELDS_MAX, ForeignField, Object, ValueShape, Writer};
use crate::definition::Constant;

/// Maximum number of bytes of a message. A number of one byte takes 56 once it is read.
const MESSAGE_BYTES_MAX: usize = 16 << 20;

const TIMESTAMP: &str = "google.protobuf.Timestamp";
const DURATION: &str = "google.protobuf.Duration";

/// Reads a set of file descriptors.
pub(super) fn object(type_name: &str, schema: &[u8]) -> Result<(Arc<Object>, MessageDescriptor), String> {
    let pool = DescriptorPool::decode(schema)
        .map_err(|error| format!("its schema is no set of protobuf's file descriptors: {error}"))?;
    let descriptor = pool
        .get_message_by_name(type_name)
        .ok_or_else(|| format!("its schema does not describe the type {type_name}"))?;
    let mut fields = 0;
    let object = object_of(&descriptor, &mut Vec::new(), &mut fields)?;
    Ok((Arc::new(object), descriptor))
}

fn object_of(
    descriptor: &MessageDescriptor,
    within: &mut Vec<MessageDescriptor>,
    count: &mut usize,
) -> Result<Object, String> {
    within.push(descriptor.clone());
    let mut object = Object { type_name: descriptor.full_name().to_owned(), ..Object::default() };
    for field in descriptor.fields() {
        let kind = field.kind();
        let is_endless = matches!(&kind, Kind::Message(inner) if within.contains(inner));
        if field.is_map() || is_endless || within.len() > DEPTH_MAX {
            continue;
        }
        *count += 1;
        if *count > FIELDS_MAX {
            return Err(format!("its schema has more than {FIELDS_MAX} fields"));
        }
        let shape = match &kind {
            Kind::Bool => ValueShape::Bool,
            Kind::String => ValueShape::Text,
            Kind::Bytes => ValueShape::Bytes,
            Kind::Double | Kind::Float => ValueShape::Float,
            Kind::Uint32 | Kind::Uint64 | Kind::Fixed32 | Kind::Fixed64 => ValueShape::Unsigned,
            Kind::Int32 | Kind::Int64 | Kind::Sint32 | Kind::Sint64 | Kind::Sfixed32 | Kind::Sfixed64 => {
                ValueShape::Integer
            }
            Kind::Enum(values) => {
                let constant = |name: &str, number: i32| Constant { name: name.to_owned(), value: number.to_string() };
                object.constants.extend(values.values().take(100).map(|value| constant(value.name(), value.number())));
                ValueShape::Integer
            }
            Kind::Message(inner) if inner.full_name() == TIMESTAMP => ValueShape::Time,
            Kind::Message(inner) if inner.full_name() == DURATION => ValueShape::Duration,
            Kind::Message(inner) => ValueShape::Object(Arc::new(object_of(inner, within, count)?)),
        };
        let shape = if field.is_list() { shape.listed() } else { shape };
        object.fields.push(ForeignField { key: field.name().to_owned(), shape });
    }
    within.pop();
    Ok(object)
}

pub(super) fn write(
    object: &Object,
    descriptor: MessageDescriptor,
    message: &[u8],
    to: &mut Writer<'_>,
) -> Result<(), String> {
    let name = descriptor.full_name().to_owned();
    if message.len() > MESSAGE_BYTES_MAX {
        let bytes = message.len();
        return Err(format!("a message of {name} has {bytes} bytes; at most {MESSAGE_BYTES_MAX} are read of protobuf"));
    }
    let message =
        DynamicMessage::decode(descriptor, message).map_err(|error| format!("the message is no {name}: {error}"))?;
    fields(object, &message, to)
}

fn fields(object: &Object, message: &DynamicMessage, to: &mut Writer<'_>) -> Result<(), String> {
    for ForeignField { key, shape } in &object.fields {
        let found = message.get_field_by_name(key).ok_or_else(|| format!("the message has no field {key}"))?;
        value(shape, &found, to)?;
    }
    Ok(())
}

fn value(shape: &ValueShape, found: &Value, to: &mut Writer<'_>) -> Result<(), String> {
    match (shape, found) {
        (ValueShape::Bool, Value::Bool(flag)) => to.0.push(u8::from(*flag)),
        (ValueShape::Integer, Value::I32(number) | Value::EnumNumber(number)) => to.integer(i64::from(*number)),
        (ValueShape::Integer, Value::I64(number)) => to.integer(*number),
        (ValueShape::Unsigned, Value::U32(number)) => to.unsigned(u64::from(*number)),
        (ValueShape::Unsigned, Value::U64(number)) => to.unsigned(*number),
        (ValueShape::Float, Value::F32(number)) => to.float(f64::from(*number)),
        (ValueShape::Float, Value::F64(number)) => to.float(*number),
        (ValueShape::Text, Value::String(text)) => to.bytes(text.as_bytes())?,
        (ValueShape::Bytes, Value::Bytes(bytes)) => to.bytes(bytes)?,
        (ValueShape::Time, Value::Message(time)) => {
            let [seconds, nanos] = seconds_and_nanos(time);
            to.time(seconds, nanos)?;
        }
        (ValueShape::Duration, Value::Message(time)) => {
            let [seconds, nanos] = seconds_and_nanos(time);
            to.duration(seconds, nanos)?;
        }
        (ValueShape::Object(object), Value::Message(message)) => fields(object, message, to)?,
        (ValueShape::List(inner), Value::List(values)) => {
            to.count(values.len())?;
            for found in values {
                match &**inner {
                    // Bytes within a list: an object with one field.
                    ValueShape::Object(object) if !matches!(found, Value::Message(_)) => {
                        if let [only] = object.fields.as_slice() {
                            value(&only.shape, found, to)?;
                        }
                    }
                    inner => value(inner, found, to)?,
                }
            }
        }
        _ => return Err("a field has another type than its schema says".to_owned()),
    }
    Ok(())
}

fn seconds_and_nanos(time: &DynamicMessage) -> [i64; 2] {
    ["seconds", "nanos"].map(|name| match time.get_field_by_name(name).as_deref() {
        Some(Value::I64(number)) => *number,
        Some(Value::I32(number)) => i64::from(*number),
        _ => 0,
    })
}
