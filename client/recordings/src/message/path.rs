//! Paths to fields, such as `pose.pose.position.x` or `ranges[3]`.
//!
//! Invariant: a path that was checked against a layout leads to a value in every message of that layout, unless an
//! index is behind the end of an array.

use super::Value;
use crate::{
    definition::Count,
    layout::{Kind, LaidField, Structure},
};

/// Why a path leads nowhere.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PathError {
    /// The text is no path.
    #[error("{0:?} is no field: use names with points between them, such as pose.position.x or ranges[0]")]
    Text(String),
    /// There is no such field.
    #[error("{type_name} has no field {name:?}; it has {fields}")]
    Missing {
        /// The type in which the name was searched.
        type_name: String,
        /// The name that was searched.
        name: String,
        /// The fields of the type.
        fields: String,
    },
    /// An index on a value that is no array, or an array without an index before a name.
    #[error("{0}")]
    Index(String),
}

/// One step of a path.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct PathStep {
    name: String,
    index: Option<usize>,
}

/// A path to a field.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Path(Vec<PathStep>);

impl Path {
    /// Reads a path.
    ///
    /// # Errors
    /// The text is no path.
    pub fn parse(text: &str) -> Result<Self, PathError> {
        let wrong = || PathError::Text(text.chars().take(80).collect());
        text.split('.').map(|part| PathStep::parse(part).ok_or_else(wrong)).collect::<Result<_, _>>().map(Self)
    }

    /// Checks the path against a layout, and gives the field at its end.
    ///
    /// # Errors
    /// There is no such field, or an index is missing or superfluous.
    pub fn field_in<'l>(&self, layout: &'l Structure) -> Result<&'l LaidField, PathError> {
        let mut structure = layout;
        let mut steps = self.0.iter().peekable();
        loop {
            let Some(step) = steps.next() else { return Err(PathError::Text(String::new())) };
            let field = structure.field(&step.name).ok_or_else(|| missing(structure, &step.name))?;
            match (field.count, step.index) {
                (Count::One, Some(_)) => {
                    return Err(PathError::Index(format!("{} is no array: leave its index out", step.name)));
                }
                (Count::Fixed(count), Some(index)) if index >= count => {
                    let text = format!("{} has {count} elements: there is no element {index}", step.name);
                    return Err(PathError::Index(text));
                }
                (Count::Fixed(_) | Count::Any, None) if steps.peek().is_some() => {
                    let text = format!("{0} is an array: name an element, such as {0}[0]", step.name);
                    return Err(PathError::Index(text));
                }
                _ => {}
            }
            if steps.peek().is_none() {
                return Ok(field);
            }
            structure = match &field.kind {
                Kind::Structure(inner) => inner,
                Kind::Primitive(_) => {
                    let name = steps.next().map(|step| step.name.clone()).unwrap_or_default();
                    let type_name = step.name.clone();
                    return Err(PathError::Missing { type_name, name, fields: "none".to_owned() });
                }
            };
        }
    }

    /// Whether the last step has an index.
    pub fn ends_with_index(&self) -> bool {
        self.0.last().is_some_and(|step| step.index.is_some())
    }

    /// The value at the end of the path; `None` behind the end of an array.
    pub fn value_in<'a>(&self, message: &Value<'a>) -> Option<Value<'a>> {
        let (last, before) = self.0.split_last()?;
        let mut value = message;
        for step in before {
            value = value.field(&step.name)?;
            if let Some(index) = step.index {
                value = value.list()?.get(index)?;
            }
        }
        let value = value.field(&last.name)?;
        match (last.index, value) {
            (None, value) => Some(value.clone()),
            (Some(index), Value::Numbers(numbers)) => numbers.get(index),
            (Some(index), value) => value.list()?.get(index).cloned(),
        }
    }
}

impl std::fmt::Display for Path {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (index, step) in self.0.iter().enumerate() {
            let point = if index == 0 { "" } else { "." };
            write!(to, "{point}{}", step.name)?;
            if let Some(index) = step.index {
                write!(to, "[{index}]")?;
            }
        }
        Ok(())
    }
}

impl PathStep {
    fn parse(text: &str) -> Option<Self> {
        let (name, index) = match text.split_once('[') {
            None => (text, None),
            Some((name, rest)) => (name, Some(rest.strip_suffix(']')?.parse().ok()?)),
        };
        let is_name = !name.is_empty() && name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
        is_name.then(|| Self { name: name.to_owned(), index })
    }
}

fn missing(structure: &Structure, name: &str) -> PathError {
    let names: Vec<&str> = structure.fields.iter().map(|field| field.name.as_str()).collect();
    let fields = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    PathError::Missing { type_name: structure.type_name.clone(), name: name.to_owned(), fields }
}
