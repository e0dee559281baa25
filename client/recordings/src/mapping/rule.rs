//! The entries of a mapping: from the fields of a topic to states, positions and traversals.
//!
//! Invariant: from one message a rule makes at most as many observations as its array has elements.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::message::{Path, VALUES_MAX, Value};

/// Maximum number of bytes of a state's name.
const NAME_BYTES_MAX: usize = 1024;

/// A place in the messages of a topic: a field, or a field of each element of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldPlace {
    /// Name of the topic.
    pub topic: String,
    /// The array whose elements are taken one by one, if any.
    pub each: Option<Path>,
    /// The field, within the element if there is an array; absent: the message or the element itself.
    pub field: Option<Path>,
}

impl FieldPlace {
    /// Reads `TOPIC.FIELD`, or `TOPIC.ARRAY[].FIELD`. Names of topics have no point.
    fn read(key: &str) -> Result<Self, String> {
        let (topic, field) = key.split_once('.').map_or((key, ""), |(topic, field)| (topic, field));
        if !topic.starts_with('/') {
            return Err("use TOPIC.FIELD, such as /door.data, or TOPIC.ARRAY[].FIELD".to_owned());
        }
        let path = |text: &str| match text {
            "" => Ok(None),
            text => Path::parse(text).map(Some).map_err(|error| error.to_string()),
        };
        let (each, field) = match field.split_once("[]") {
            None => (None, path(field)?),
            Some((array, rest)) => (path(array)?, path(rest.trim_start_matches('.'))?),
        };
        Ok(Self { topic: topic.to_owned(), each, field })
    }

    /// The values in which the rule finds its fields: the message itself, or the elements of its array.
    pub(crate) fn elements<'a>(&self, message: &Value<'a>) -> Vec<Value<'a>> {
        match &self.each {
            None => vec![message.clone()],
            Some(each) => match each.value_in(message) {
                Some(Value::List(values)) => values,
                Some(Value::Numbers(numbers)) => {
                    (0..numbers.len().min(VALUES_MAX)).filter_map(|index| numbers.get(index)).collect()
                }
                _ => Vec::new(),
            },
        }
    }

    /// The field within an element.
    pub(crate) fn value<'a>(&self, element: &Value<'a>) -> Option<Value<'a>> {
        match &self.field {
            None => Some(element.clone()),
            Some(field) => field.value_in(element),
        }
    }
}

/// A name with fields in braces, such as `door-{door_name}`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Template(Vec<NamePart>);

#[derive(Clone, Debug, PartialEq, Eq)]
enum NamePart {
    Text(String),
    Field(Path),
}

impl Template {
    /// Reads a name.
    ///
    /// # Errors
    /// A brace is not closed, or its content is not a field.
    pub fn read(text: &str) -> Result<Self, String> {
        let mut parts = Vec::new();
        let mut rest = text;
        while let Some((before, from)) = rest.split_once('{') {
            let (field, behind) = from.split_once('}').ok_or_else(|| format!("{text:?} has no }} behind its {{"))?;
            if !before.is_empty() {
                parts.push(NamePart::Text(before.to_owned()));
            }
            parts.push(NamePart::Field(Path::parse(field).map_err(|error| error.to_string())?));
            rest = behind;
        }
        if !rest.is_empty() {
            parts.push(NamePart::Text(rest.to_owned()));
        }
        if parts.is_empty() { Err("the name of the state is empty".to_owned()) } else { Ok(Self(parts)) }
    }

    /// A name without fields.
    pub fn plain(name: &str) -> Self {
        Self(vec![NamePart::Text(name.to_owned())])
    }

    /// The name for an element; `None` if a field is missing there, or the name is too long. Slashes within fields
    /// become `-`, because they separate the parts of names.
    pub fn name(&self, element: &Value<'_>) -> Option<String> {
        let mut name = String::new();
        for part in &self.0 {
            match part {
                NamePart::Text(text) => name += text,
                NamePart::Field(path) => name += &shown(&path.value_in(element)?)?.replace('/', "-"),
            }
        }
        (name.len() <= NAME_BYTES_MAX).then_some(name)
    }

    /// The name as the mapping writes it.
    pub fn text(&self) -> String {
        let text = |part: &NamePart| match part {
            NamePart::Text(text) => text.clone(),
            NamePart::Field(path) => format!("{{{path}}}"),
        };
        self.0.iter().map(text).collect()
    }
}

/// A value as a word: text as it is, numbers in decimal.
pub(crate) fn shown(value: &Value<'_>) -> Option<String> {
    match value {
        Value::Text(_) | Value::WideText(_) => value.text(),
        Value::Bool(value) => Some(value.to_string()),
        Value::Integer(value) => Some(value.to_string()),
        Value::Float(value) => Some(value.to_string()),
        _ => None,
    }
}

/// Kind of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueKind {
    /// A number from 0 to 1.
    #[default]
    Probability,
    /// Any number.
    Continuous,
    /// A whole number from 0 on.
    Count,
    /// Radians.
    Angle,
    /// A label.
    Categorical,
}

/// The meaning of the messages of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reports {
    /// Readings of the state at the times of the messages.
    #[default]
    Samples,
    /// Sent when the state changes: it holds until the next one.
    Changes,
    /// Each message means that something happened.
    Events,
}

/// The conversion of a field to a value.
#[derive(Clone, Debug, PartialEq)]
pub enum ValueRule {
    /// The field as a number; the length of an array.
    Number,
    /// The field as a word, by a table; other words are left out.
    Table(BTreeMap<String, String>),
    /// One value, whatever the message contains.
    Same(f64),
}

/// Observations of states, from a field of a topic.
#[derive(Clone, Debug, PartialEq)]
pub struct StateRule {
    /// The place of the value.
    pub place: FieldPlace,
    /// Name of the state.
    pub state: Template,
    /// Kind of the state.
    pub kind: ValueKind,
    /// The meaning of the messages.
    pub reports: Reports,
    /// The conversion to a value.
    pub value: ValueRule,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum StateText {
    Name(String),
    Full(Box<StateFields>),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StateFields {
    state: String,
    #[serde(default)]
    kind: Option<ValueKind>,
    #[serde(default)]
    reports: Reports,
    #[serde(default)]
    values: Option<BTreeMap<Word, Word>>,
    #[serde(default)]
    value: Option<f64>,
}

/// A word, however YAML understands it.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Word(String);

impl<'de> Deserialize<'de> for Word {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Word;

            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("a word or a number")
            }

            fn visit_str<E>(self, text: &str) -> Result<Word, E> {
                Ok(Word(text.to_owned()))
            }

            fn visit_bool<E>(self, value: bool) -> Result<Word, E> {
                Ok(Word(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Word, E> {
                Ok(Word(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Word, E> {
                Ok(Word(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Word, E> {
                Ok(Word(value.to_string()))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl StateRule {
    pub(super) fn read(key: &str, text: StateText) -> Result<Self, String> {
        let fields = match text {
            StateText::Full(fields) => *fields,
            StateText::Name(state) => {
                StateFields { state, kind: None, reports: Reports::Samples, values: None, value: None }
            }
        };
        let kind = fields.kind.unwrap_or_default();
        let value = match (fields.values, fields.value) {
            (Some(_), Some(_)) => return Err("give values or value, not both".to_owned()),
            (Some(values), None) => {
                let table: BTreeMap<String, String> = values.into_iter().map(|(from, to)| (from.0, to.0)).collect();
                let is_number = |text: &String| text.parse::<f64>().is_ok_and(f64::is_finite);
                if let Some(word) = table.values().find(|to| kind != ValueKind::Categorical && !is_number(to)) {
                    return Err(format!("{word:?} is no number: only kind categorical has words as values"));
                }
                ValueRule::Table(table)
            }
            (None, Some(value)) if value.is_finite() => ValueRule::Same(value),
            (None, Some(value)) => return Err(format!("value {value} is not finite")),
            (None, None) => ValueRule::Number,
        };
        if kind == ValueKind::Categorical && matches!(value, ValueRule::Same(_)) {
            return Err("a state of kind categorical needs values, or the field's own words".to_owned());
        }
        if fields.reports == Reports::Events && kind != ValueKind::Probability && kind != ValueKind::Count {
            return Err("reports: events is for the kinds probability and count".to_owned());
        }
        Ok(Self {
            place: FieldPlace::read(key)?,
            state: Template::read(&fields.state)?,
            kind,
            reports: fields.reports,
            value,
        })
    }
}

/// Observations of positions, from a field with x, y and z.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionRule {
    /// The place of the point or the pose.
    pub place: FieldPlace,
    /// Name of the vector.
    pub state: Template,
    /// Whether z is taken too.
    pub has_height: bool,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum PositionText {
    Name(String),
    Full(PositionFields),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PositionFields {
    state: String,
    #[serde(default)]
    dimensions: Option<u8>,
}

impl PositionRule {
    pub(super) fn read(key: &str, text: PositionText) -> Result<Self, String> {
        let (state, dimensions) = match text {
            PositionText::Name(state) => (state, None),
            PositionText::Full(PositionFields { state, dimensions }) => (state, dimensions),
        };
        let has_height = match dimensions.unwrap_or(2) {
            2 => false,
            3 => true,
            other => return Err(format!("dimensions is {other}: use 2 or 3")),
        };
        Ok(Self { place: FieldPlace::read(key)?, state: Template::read(&state)?, has_height })
    }
}

/// Traversals of edges, from the statistics of a navigation.
#[derive(Clone, Debug, PartialEq)]
pub struct TraversalRule {
    /// Name of the topic.
    pub topic: String,
    /// Field with the node where the edge begins.
    pub from: Path,
    /// Field with the node where it ends.
    pub to: Path,
    /// Field with the duration in seconds; the message was sent at the end.
    pub seconds: Path,
    /// Field that contains how it ended.
    pub status: Path,
    /// Words of the status, in small letters, that mean success.
    pub success: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TraversalText {
    from: String,
    to: String,
    seconds: String,
    status: String,
    success: Vec<Word>,
}

impl TraversalRule {
    pub(super) fn read(key: &str, text: TraversalText) -> Result<Self, String> {
        let place = FieldPlace::read(key)?;
        if place.field.is_some() || place.each.is_some() {
            return Err("use the name of the topic alone".to_owned());
        }
        let path = |text: &str| Path::parse(text).map_err(|error| error.to_string());
        Ok(Self {
            topic: place.topic,
            from: path(&text.from)?,
            to: path(&text.to)?,
            seconds: path(&text.seconds)?,
            status: path(&text.status)?,
            success: text.success.into_iter().map(|word| word.0.to_lowercase()).collect(),
        })
    }

    /// The rule for the statistics of STRANDS' topological navigation.
    pub(crate) fn strands(topic: &str) -> Option<Self> {
        let path = |text| Path::parse(text).ok();
        Some(Self {
            topic: topic.to_owned(),
            from: path("origin")?,
            to: path("target")?,
            seconds: path("operation_time")?,
            status: path("status")?,
            success: vec!["success".to_owned()],
        })
    }
}

impl StateRule {
    /// A rule that takes a field as a number.
    pub(crate) fn plain(topic: &str, field: &str, state: Template, value: ValueRule) -> Option<Self> {
        let place = FieldPlace { topic: topic.to_owned(), each: None, field: Some(Path::parse(field).ok()?) };
        Some(Self { place, state, kind: ValueKind::Probability, reports: Reports::Samples, value })
    }
}

impl PositionRule {
    /// A rule that takes a field as a position in the plane.
    pub(crate) fn plain(topic: &str, each: Option<&str>, field: &str, state: Template) -> Option<Self> {
        let path = |text: &str| Path::parse(text).ok();
        let place = FieldPlace { topic: topic.to_owned(), each: each.and_then(path), field: path(field) };
        Some(Self { place, state, has_height: false })
    }
}
