//! Definitions of messages, in the language of ROS' `.msg` files.
//!
//! Invariant: a set of definitions holds each type once, by its full name without the folder of ROS 2, such as
//! `sensor_msgs/LaserScan`. A type may be used before it is defined; whether all types are there is checked when a
//! layout is made of them.

use std::collections::HashMap;

/// Maximum number of types of a topic's definition.
const TYPES_MAX: usize = 1_000;
/// Maximum number of fields and constants of a type.
const MEMBERS_MAX: usize = 2_000;

/// The header of messages, and its name before 2010.
const HEADER: &str = "std_msgs/Header";
const OLD_HEADER: &str = "roslib/Header";

/// A type that every language of messages has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Primitive {
    /// True or false, one byte.
    Bool,
    /// Signed, one byte.
    Int8,
    /// Unsigned, one byte.
    Uint8,
    /// Signed, two bytes.
    Int16,
    /// Unsigned, two bytes.
    Uint16,
    /// Signed, four bytes.
    Int32,
    /// Unsigned, four bytes.
    Uint32,
    /// Signed, eight bytes.
    Int64,
    /// Unsigned, eight bytes.
    Uint64,
    /// Four bytes.
    Float32,
    /// Eight bytes.
    Float64,
    /// Text.
    Text,
    /// Text of wide letters, UTF-16.
    WideText,
    /// Seconds and nanoseconds of ROS 1, both unsigned.
    Time,
    /// Seconds and nanoseconds of ROS 1, both signed.
    Duration,
}

impl Primitive {
    fn of_name(name: &str) -> Option<Self> {
        Some(match name {
            "bool" | "boolean" => Self::Bool,
            "int8" => Self::Int8,
            // In ROS 1 a byte is signed and a char is not; in ROS 2 both are unsigned. Values above 127 are rare.
            "uint8" | "char" | "byte" | "octet" => Self::Uint8,
            "int16" => Self::Int16,
            "uint16" => Self::Uint16,
            "int32" => Self::Int32,
            "uint32" => Self::Uint32,
            "int64" => Self::Int64,
            "uint64" => Self::Uint64,
            "float32" => Self::Float32,
            "float64" => Self::Float64,
            "string" => Self::Text,
            "wstring" => Self::WideText,
            "time" => Self::Time,
            "duration" => Self::Duration,
            _ => return None,
        })
    }

    /// Number of bytes, or `None` for text.
    pub fn bytes(self) -> Option<usize> {
        Some(match self {
            Self::Bool | Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Int64 | Self::Uint64 | Self::Float64 | Self::Time | Self::Duration => 8,
            Self::Text | Self::WideText => return None,
        })
    }
}

/// The type of a field, or of the elements of a field that is an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// One value.
    Primitive(Primitive),
    /// Another type, by its full name.
    Named(String),
}

/// The number of values of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// One.
    One,
    /// This number, whatever the message contains.
    Fixed(usize),
    /// The number that the message states.
    Any,
}

/// A field of a type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldDefinition {
    /// Name of the field.
    pub name: String,
    /// Type of the field, or of its elements.
    pub field_type: FieldType,
    /// The number of its values.
    pub count: Count,
}

/// A constant of a type, such as `MODE_CLOSED = 0`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Constant {
    /// Name of the constant.
    pub name: String,
    /// The value as the definition writes it.
    pub value: String,
}

/// A type of messages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Definition {
    /// The fields, in the order in which a message has them.
    pub fields: Vec<FieldDefinition>,
    /// Constants of the type.
    pub constants: Vec<Constant>,
}

/// Why a definition cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DefinitionError {
    /// A line is no field, constant or comment.
    #[error("the definition of {type_name}: {line:?} is no field")]
    Line {
        /// The type.
        type_name: String,
        /// The line.
        line: String,
    },
    /// The definition has more parts than are read.
    #[error("the definition of {type_name} has more than {max} {what}")]
    TooLong {
        /// The type.
        type_name: String,
        /// The items of which there are too many.
        what: &'static str,
        /// The limit.
        max: usize,
    },
    /// A type is used, and defined nowhere.
    #[error("the type {0} is not defined in the recording")]
    Missing(String),
    /// A type contains itself.
    #[error("the type {0} contains itself")]
    Endless(String),
}

/// The name of a type without the folder of ROS 2: `sensor_msgs/msg/LaserScan` becomes `sensor_msgs/LaserScan`.
pub fn short_name(name: &str) -> String {
    let separated = name.replace("::", "/");
    let parts: Vec<&str> = separated.split('/').filter(|part| !part.is_empty()).collect();
    match parts.as_slice() {
        [package, "msg" | "msg_", name] => format!("{package}/{name}"),
        [package, "msg", "dds_", name] => format!("{package}/{}", name.strip_suffix('_').unwrap_or(name)),
        parts => parts.join("/"),
    }
}

/// Reads a definition with the definitions that follow it, as recordings store them: behind a line of `=`, a line
/// `MSG: package/Type` begins the next type.
///
/// # Errors
/// A line is no field, or the definition is too long.
pub fn parse(type_name: &str, text: &str) -> Result<HashMap<String, Definition>, DefinitionError> {
    let mut types = HashMap::new();
    let mut name = short_name(type_name);
    let mut lines: Vec<&str> = Vec::new();
    for line in text.lines() {
        let trimmed = line.trim();
        if trimmed.len() >= 10 && trimmed.bytes().all(|byte| byte == b'=') {
            continue;
        }
        let Some(next) = trimmed.strip_prefix("MSG:") else {
            lines.push(line);
            continue;
        };
        let definition = parse_one(&name, &lines)?;
        lines.clear();
        types.entry(name).or_insert(definition);
        if types.len() >= TYPES_MAX {
            return Err(DefinitionError::TooLong { type_name: type_name.to_owned(), what: "types", max: TYPES_MAX });
        }
        name = short_name(next.trim());
        if name == OLD_HEADER {
            HEADER.clone_into(&mut name);
        }
    }
    let definition = parse_one(&name, &lines)?;
    types.entry(name).or_insert(definition);
    Ok(types)
}

fn parse_one(type_name: &str, lines: &[&str]) -> Result<Definition, DefinitionError> {
    let mut definition = Definition::default();
    let package = type_name.split('/').next().unwrap_or_default();
    for line in lines {
        parse_line(package, line, &mut definition)
            .ok_or_else(|| DefinitionError::Line { type_name: type_name.to_owned(), line: shortened(line) })?;
        if definition.fields.len() + definition.constants.len() > MEMBERS_MAX {
            let type_name = type_name.to_owned();
            return Err(DefinitionError::TooLong { type_name, what: "fields", max: MEMBERS_MAX });
        }
    }
    Ok(definition)
}

/// Adds what a line defines; `None`: it is no line of a definition.
fn parse_line(package: &str, line: &str, definition: &mut Definition) -> Option<()> {
    let code = line.trim_start();
    if code.is_empty() || code.starts_with('#') || code.trim_end().is_empty() {
        return Some(());
    }
    let (type_text, rest) = code.split_once(char::is_whitespace)?;
    let rest = rest.trim_start();
    let name_length =
        rest.find(|letter: char| !(letter.is_ascii_alphanumeric() || letter == '_')).unwrap_or(rest.len());
    let (name, behind) = rest.split_at(name_length);
    if name.is_empty() {
        return None;
    }
    if let Some(value) = behind.trim_start().strip_prefix('=') {
        // A constant of type string may contain `#`.
        let is_text = type_text.starts_with("string") || type_text.starts_with("wstring");
        let value = if is_text { value } else { value.split('#').next().unwrap_or_default() };
        definition.constants.push(Constant { name: name.to_owned(), value: value.trim().to_owned() });
        return Some(());
    }
    // Behind the name a default value of ROS 2 or a comment may follow; neither changes the layout.
    let (base, count) = counted(type_text)?;
    let base = base.split("<=").next().unwrap_or(base);
    let field_type = match Primitive::of_name(base) {
        Some(primitive) => FieldType::Primitive(primitive),
        None => FieldType::Named(full_name(package, base)?),
    };
    definition.fields.push(FieldDefinition { name: name.to_owned(), field_type, count });
    Some(())
}

/// The type of the elements, and how many there are: `float64[36]`, `uint8[]`, `uint8[<=10]`.
fn counted(type_text: &str) -> Option<(&str, Count)> {
    let Some((base, bounds)) = type_text.split_once('[') else { return Some((type_text, Count::One)) };
    let bounds = bounds.strip_suffix(']')?;
    let count = match bounds {
        "" => Count::Any,
        bounded if bounded.starts_with("<=") => Count::Any,
        fixed => Count::Fixed(fixed.trim().parse().ok()?),
    };
    Some((base, count))
}

fn full_name(package: &str, name: &str) -> Option<String> {
    let is_word = |text: &str| text.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    if name == "Header" || name == OLD_HEADER {
        return Some(HEADER.to_owned());
    }
    let short = short_name(name);
    match short.split_once('/') {
        None if is_word(&short) && !short.is_empty() => Some(format!("{package}/{short}")),
        Some((package, name)) if is_word(package) && is_word(name) && !name.is_empty() => Some(short),
        _ => None,
    }
}

/// A line, cut to a length that a message can show.
fn shortened(line: &str) -> String {
    line.trim().chars().take(80).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fields_constants_and_nested_types_are_read() -> Result<(), DefinitionError> {
        let text = "# A door\nstd_msgs/Header header\nuint8 CLOSED=0 # shut\nstring NAME= a # b\nDoorMode mode\n\
                    float64[36] covariance\nuint8[] data\nstring<=8[<=3] words\nint32 speed 5\nbool<=2 odd # x\n\
                    ================================================================================\n\
                    MSG: rmf_door_msgs/msg/DoorMode\nuint32 value\n";
        let types = parse("rmf_door_msgs/msg/DoorState", text)?;
        let door = types.get("rmf_door_msgs/DoorState").cloned().unwrap_or_default();
        let field =
            |name: &str, field_type: FieldType, count| FieldDefinition { name: name.to_owned(), field_type, count };
        let named = |name: &str| FieldType::Named(name.to_owned());
        assert_eq!(
            door.fields,
            [
                field("header", named("std_msgs/Header"), Count::One),
                field("mode", named("rmf_door_msgs/DoorMode"), Count::One),
                field("covariance", FieldType::Primitive(Primitive::Float64), Count::Fixed(36)),
                field("data", FieldType::Primitive(Primitive::Uint8), Count::Any),
                field("words", FieldType::Primitive(Primitive::Text), Count::Any),
                field("speed", FieldType::Primitive(Primitive::Int32), Count::One),
                field("odd", FieldType::Primitive(Primitive::Bool), Count::One),
            ]
        );
        let constant = |name: &str, value: &str| Constant { name: name.to_owned(), value: value.to_owned() };
        assert_eq!(door.constants, [constant("CLOSED", "0"), constant("NAME", "a # b")]);
        assert_eq!(types.get("rmf_door_msgs/DoorMode").map(|mode| mode.fields.len()), Some(1));
        Ok(())
    }

    #[test]
    fn a_line_that_is_no_field_is_shown() {
        let error = parse("a/B", "int32 x\nint32\n");
        assert!(error.is_err_and(|error| error.to_string().contains("\"int32\" is no field")));
        assert!(parse("a/B", "int32[x] y").is_err());
        assert!(parse("a/B", "in-t y").is_err());
    }

    #[test]
    fn the_folder_of_ros_2_is_left_out() {
        for (long, short) in [
            ("sensor_msgs/msg/LaserScan", "sensor_msgs/LaserScan"),
            ("sensor_msgs::msg::dds_::LaserScan_", "sensor_msgs/LaserScan"),
            ("tf/tfMessage", "tf/tfMessage"),
            ("", ""),
        ] {
            assert_eq!(short_name(long), short);
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[a-zA-Z0-9_/\\[\\]<=# .\n]{0,200}") {
            let _ = parse("a/B", &text);
        }
    }
}
