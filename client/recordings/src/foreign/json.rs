//! Messages in JSON, by the schema that a recording holds.
//!
//! Invariant: a field that a message lacks, or that is null, is 0, NaN, false or empty, by its kind.

use std::sync::Arc;

use serde_json::Value;

use super::{DEPTH_MAX, FIELDS_MAX, ForeignField, Object, ValueShape, Writer};

/// Reads a schema in the language of JSON Schema.
pub(super) fn object(type_name: &str, schema: &str) -> Result<Arc<Object>, String> {
    let root: Value = serde_json::from_str(schema).map_err(|error| format!("its schema is no JSON: {error}"))?;
    let mut reading = Reading { root: &root, fields: 0 };
    match reading.shape(&root, type_name, 0)? {
        Some(ValueShape::Object(object)) => Ok(object),
        _ => Err("its schema describes no object with properties".to_owned()),
    }
}

struct Reading<'s> {
    root: &'s Value,
    fields: usize,
}

impl Reading<'_> {
    /// The shape that a schema describes; absent if it describes none that is read.
    fn shape(&mut self, schema: &Value, name: &str, depth: usize) -> Result<Option<ValueShape>, String> {
        if depth > DEPTH_MAX {
            return Ok(None);
        }
        let root = self.root;
        if let Some(path) = schema.get("$ref").and_then(Value::as_str) {
            let found = path.strip_prefix('#').and_then(|pointer| root.pointer(pointer));
            return found.map_or(Ok(None), |found| self.shape(found, name, depth + 1));
        }
        let kind = match schema.get("type") {
            Some(Value::String(kind)) => kind.as_str(),
            // A field that may also be null.
            Some(Value::Array(kinds)) => {
                kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null").unwrap_or_default()
            }
            _ => "",
        };
        Ok(Some(match kind {
            "boolean" => ValueShape::Bool,
            "integer" => ValueShape::Integer,
            "number" => ValueShape::Float,
            "string" if schema.get("contentEncoding").and_then(Value::as_str) == Some("base64") => ValueShape::Bytes,
            "string" => ValueShape::Text,
            "array" => {
                let Some(items) = schema.get("items") else { return Ok(None) };
                let Some(inner) = self.shape(items, name, depth + 1)? else { return Ok(None) };
                inner.listed()
            }
            "object" => return self.object(schema, name, depth),
            _ if schema.get("properties").is_some() => return self.object(schema, name, depth),
            _ => {
                // An enumeration, by the type of its words.
                let options = ["oneOf", "anyOf", "enum"].iter().find_map(|key| schema.get(key)?.as_array());
                let option = |option: &Value| option.get("const").unwrap_or(option).clone();
                match options.and_then(|options| options.first()).map(option) {
                    Some(Value::Number(_)) => ValueShape::Integer,
                    Some(Value::String(_)) => ValueShape::Text,
                    _ => return Ok(None),
                }
            }
        }))
    }

    fn object(&mut self, schema: &Value, name: &str, depth: usize) -> Result<Option<ValueShape>, String> {
        let Some(properties) = schema.get("properties").and_then(Value::as_object) else { return Ok(None) };
        let is_time =
            |nanos: &str| properties.len() == 2 && properties.contains_key("sec") && properties.contains_key(nanos);
        if is_time("nsec") || is_time("nanosec") {
            let is_duration = schema.get("title").and_then(Value::as_str) == Some("duration");
            return Ok(Some(if is_duration { ValueShape::Duration } else { ValueShape::Time }));
        }
        let mut object = Object { type_name: name.to_owned(), ..Object::default() };
        for (key, schema) in properties {
            self.fields += 1;
            if self.fields > FIELDS_MAX {
                return Err(format!("its schema has more than {FIELDS_MAX} fields"));
            }
            if let Some(shape) = self.shape(schema, key, depth + 1)? {
                object.fields.push(ForeignField { key: key.clone(), shape });
            }
        }
        Ok(Some(ValueShape::Object(Arc::new(object))))
    }
}

pub(super) fn write(object: &Object, message: &[u8], to: &mut Writer<'_>) -> Result<(), String> {
    let message: Value = serde_json::from_slice(message).map_err(|error| format!("the message is no JSON: {error}"))?;
    if !message.is_object() {
        return Err("the message is no object of JSON".to_owned());
    }
    fields(object, &message, to)
}

fn fields(object: &Object, message: &Value, to: &mut Writer<'_>) -> Result<(), String> {
    for ForeignField { key, shape } in &object.fields {
        value(shape, message.get(key).unwrap_or(&Value::Null), to).map_err(|error| format!("{key}: {error}"))?;
    }
    Ok(())
}

fn value(shape: &ValueShape, found: &Value, to: &mut Writer<'_>) -> Result<(), String> {
    let wrong = |wanted: &str| {
        let text: String = found.to_string().chars().take(80).collect();
        format!("{text} is not {wanted}")
    };
    match (shape, found) {
        (ValueShape::Bool, Value::Bool(flag)) => to.0.push(u8::from(*flag)),
        (ValueShape::Bool, Value::Null) => to.0.push(0),
        (ValueShape::Integer, Value::Null) => to.integer(0),
        (ValueShape::Integer, Value::Number(number)) => {
            let whole = number
                .as_i64()
                .or_else(|| number.as_f64().filter(|number| number.fract() == 0.0).map(|number| number as i64));
            to.integer(whole.ok_or_else(|| wrong("a whole number of 64 bits"))?);
        }
        // Numbers of 64 bits are also written as text.
        (ValueShape::Integer, Value::String(text)) => to.integer(text.parse().map_err(|_| wrong("a whole number"))?),
        (ValueShape::Float, Value::Null) => to.float(f64::NAN),
        (ValueShape::Float, Value::Number(number)) => to.float(number.as_f64().ok_or_else(|| wrong("a number"))?),
        // JSON has no words for these numbers.
        (ValueShape::Float, Value::String(text)) => to.float(text.parse().map_err(|_| wrong("a number"))?),
        (ValueShape::Text, Value::Null) | (ValueShape::Bytes, Value::Null) | (ValueShape::List(_), Value::Null) => {
            to.count(0)?;
        }
        (ValueShape::Text, Value::String(text)) => to.bytes(text.as_bytes())?,
        (ValueShape::Bytes, Value::String(text)) => to.bytes(&base64(text).ok_or_else(|| wrong("text in base64"))?)?,
        (ValueShape::Time, found) => {
            let [seconds, nanos] = seconds_and_nanos(found);
            to.time(seconds, nanos)?;
        }
        (ValueShape::Duration, found) => {
            let [seconds, nanos] = seconds_and_nanos(found);
            to.duration(seconds, nanos)?;
        }
        (ValueShape::Object(object), Value::Null | Value::Object(_)) => fields(object, found, to)?,
        (ValueShape::List(inner), Value::Array(values)) => {
            to.count(values.len())?;
            for found in values {
                match &**inner {
                    // A list within a list: an object with one field.
                    ValueShape::Object(object) if found.is_array() => {
                        if let [only] = object.fields.as_slice() {
                            value(&only.shape, found, to)?;
                        }
                    }
                    inner => value(inner, found, to)?,
                }
            }
        }
        (ValueShape::Bool, _) => return Err(wrong("true or false")),
        (ValueShape::Integer | ValueShape::Unsigned, _) => return Err(wrong("a whole number")),
        (ValueShape::Float, _) => return Err(wrong("a number")),
        (ValueShape::Text | ValueShape::Bytes, _) => return Err(wrong("text")),
        (ValueShape::List(_), _) => return Err(wrong("a list")),
        (ValueShape::Object(_), _) => return Err(wrong("an object")),
    }
    Ok(())
}

fn seconds_and_nanos(time: &Value) -> [i64; 2] {
    let part = |names: &[&str]| names.iter().find_map(|name| time.get(name)?.as_i64()).unwrap_or(0);
    [part(&["sec"]), part(&["nsec", "nanosec"])]
}

/// The bytes of a text in base64, of the usual or the other alphabet.
fn base64(text: &str) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut count) = (0_u32, 0);
    for letter in text.bytes().filter(|letter| !letter.is_ascii_whitespace()) {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' => break,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count & 0xFF) as u8);
        }
    }
    Some(bytes)
}

#[test]
fn base64_is_read_in_both_alphabets() {
    assert_eq!(base64("AQIDBA=="), Some(vec![1, 2, 3, 4]));
    assert_eq!(base64("+/8="), Some(vec![0xFB, 0xFF]));
    assert_eq!(base64("-_8"), Some(vec![0xFB, 0xFF]));
    assert_eq!(base64(""), Some(Vec::new()));
    assert_eq!(base64("A*"), None);
}
