//! The layout of a type of messages: its definition with all types inside put in their places.
//!
//! Invariant: a layout is finite: no type contains itself, and the number of fields is bounded.

use std::{collections::HashMap, sync::Arc};

use crate::{
    built_in,
    definition::{self, Constant, Count, Definition, DefinitionError, FieldType, Primitive},
    recording::Encoding,
};

/// Maximum depth of types within types.
const DEPTH_MAX: usize = 32;
/// Maximum number of fields of a layout, the fields of the types inside included.
const FIELDS_MAX: usize = 10_000;

/// The kind of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A value that has no fields.
    Primitive(Primitive),
    /// A value with fields.
    Structure(Arc<Structure>),
}

/// The fields of a type.
#[derive(Debug, PartialEq, Eq)]
pub struct Structure {
    /// Full name of the type.
    pub type_name: String,
    /// The fields, in the order of the bytes.
    pub fields: Vec<LaidField>,
    /// The constants of the type.
    pub constants: Vec<Constant>,
}

/// A field with its kind and count.
#[derive(Debug, PartialEq, Eq)]
pub struct LaidField {
    /// Name of the field.
    pub name: String,
    /// The kind of its values.
    pub kind: Kind,
    /// The number of its values.
    pub count: Count,
}

impl Structure {
    /// The field of a name.
    pub fn field(&self, name: &str) -> Option<&LaidField> {
        self.fields.iter().find(|field| field.name == name)
    }
}

/// Makes the layout of a type. In messages of ROS 2, types that `text` does not define are looked up among the types
/// that tidemap knows; with an empty text that is all types. The types of ROS 1 have other fields, and bags define all
/// of them.
///
/// # Errors
/// The text is no definition, or a type is missing or contains itself.
pub fn of_type(type_name: &str, text: &str, encoding: &Encoding) -> Result<Arc<Structure>, DefinitionError> {
    let name = definition::short_name(type_name);
    // An empty definition belongs to a type without fields, such as std_msgs/Empty, or is a missing definition.
    let types = if text.trim().is_empty() { HashMap::new() } else { definition::parse(&name, text)? };
    let mut making = Making { types, knows_usual: *encoding == Encoding::Cdr, made: HashMap::new(), fields: 0 };
    making.structure(&name, 0)
}

struct Making {
    types: HashMap<String, Definition>,
    knows_usual: bool,
    made: HashMap<String, Arc<Structure>>,
    fields: usize,
}

impl Making {
    fn structure(&mut self, name: &str, depth: usize) -> Result<Arc<Structure>, DefinitionError> {
        if let Some(made) = self.made.get(name) {
            return Ok(made.clone());
        }
        if depth > DEPTH_MAX {
            return Err(DefinitionError::Endless(name.to_owned()));
        }
        let definition = match self.types.get(name) {
            Some(definition) => definition.clone(),
            None => {
                let usual = if self.knows_usual { built_in::definition(name) } else { None };
                usual.ok_or_else(|| DefinitionError::Missing(name.to_owned()))?
            }
        };
        self.fields += definition.fields.len();
        if self.fields > FIELDS_MAX {
            let type_name = name.to_owned();
            return Err(DefinitionError::TooLong { type_name, what: "fields", max: FIELDS_MAX });
        }
        let mut fields = Vec::with_capacity(definition.fields.len());
        for field in definition.fields {
            let kind = match field.field_type {
                FieldType::Primitive(primitive) => Kind::Primitive(primitive),
                FieldType::Named(inner) => Kind::Structure(self.structure(&inner, depth + 1)?),
            };
            fields.push(LaidField { name: field.name, kind, count: field.count });
        }
        let structure = Arc::new(Structure { type_name: name.to_owned(), fields, constants: definition.constants });
        self.made.insert(name.to_owned(), structure.clone());
        Ok(structure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_inside_come_from_the_recording_and_else_from_the_known_ones() -> Result<(), DefinitionError> {
        let layout = of_type(
            "a_msgs/Own",
            "std_msgs/Header header\nInner inner\n====================\nMSG: a_msgs/Inner\nint8 x",
            &Encoding::Cdr,
        )?;
        assert_eq!(layout.fields.iter().map(|field| field.name.as_str()).collect::<Vec<_>>(), ["header", "inner"]);
        let missing = of_type("a_msgs/Own", "Inner inner", &Encoding::Cdr);
        assert_eq!(missing, Err(DefinitionError::Missing("a_msgs/Inner".to_owned())));
        Ok(())
    }

    #[test]
    fn a_type_that_contains_itself_is_refused() {
        assert_eq!(of_type("a/B", "a/B inner", &Encoding::Cdr), Err(DefinitionError::Endless("a/B".to_owned())));
    }
}
