//! The content of protocol files: keys and texts with their lines.
//!
//! Invariant: a text is kept as the file has it, so that errors quote it unchanged; an unknown key is refused here.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{Error as _, MapAccess, SeqAccess, Visitor},
};
use serde_saphyr::Spanned;

/// A text with its line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Word {
    /// The number of the line, from 1.
    pub line: u64,
    /// The text; a number as the parser prints it.
    pub text: String,
}

/// One text or a list of texts.
#[derive(Clone, Debug)]
pub(crate) struct Words {
    /// The first line.
    pub line: u64,
    /// The texts. Their lines differ in a list only.
    pub words: Vec<Word>,
}

/// A model of a protocol: a name alone, or with parameters.
#[derive(Clone, Debug)]
pub(crate) struct RawModel {
    /// The name of the kind.
    pub kind: Word,
    /// The parameters, in the order of the file.
    pub parameters: Vec<(Word, Words)>,
}

/// The file of a comparison of models.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawProtocol {
    pub name: Option<Word>,
    pub zone: Option<Word>,
    pub kind: Option<Word>,
    pub format: Option<Word>,
    pub states: Option<Words>,
    pub train: Option<Words>,
    pub test: Option<Words>,
    pub retrain: Option<Word>,
    pub ahead: Option<Words>,
    pub lists: Option<Word>,
    pub models: Option<Vec<RawModel>>,
    pub tuning: Option<RawTuning>,
    pub baseline: Option<Word>,
    pub significance: Option<Word>,
    pub predictions: Option<Word>,
    pub out: Option<Word>,
}

/// The section `tuning`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawTuning {
    pub folds: Word,
    pub fold: Word,
}

/// A text, number or Boolean, as text.
struct Scalar(String);

impl<'de> Deserialize<'de> for Scalar {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(Scalar)
    }
}

impl<'de> Deserialize<'de> for Word {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let spanned = Spanned::<Scalar>::deserialize(deserializer)?;
        Ok(Self { line: spanned.referenced.line(), text: spanned.value.0 })
    }
}

impl<'de> Deserialize<'de> for Words {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Spanned { value, referenced, .. } = Spanned::<OneOrMany>::deserialize(deserializer)?;
        let line = referenced.line();
        let words = match value {
            OneOrMany::One(text) => vec![Word { line, text }],
            OneOrMany::Many(words) => words,
        };
        Ok(Self { line, words })
    }
}

enum OneOrMany {
    One(String),
    Many(Vec<Word>),
}

impl<'de> Deserialize<'de> for OneOrMany {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(OneOrManyVisitor)
    }
}

struct OneOrManyVisitor;

impl<'de> Visitor<'de> for OneOrManyVisitor {
    type Value = OneOrMany;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value or a list of values")
    }

    fn visit_str<E>(self, text: &str) -> Result<OneOrMany, E> {
        Ok(OneOrMany::One(text.to_owned()))
    }

    fn visit_u64<E>(self, number: u64) -> Result<OneOrMany, E> {
        Ok(OneOrMany::One(number.to_string()))
    }

    fn visit_i64<E>(self, number: i64) -> Result<OneOrMany, E> {
        Ok(OneOrMany::One(number.to_string()))
    }

    fn visit_f64<E>(self, number: f64) -> Result<OneOrMany, E> {
        Ok(OneOrMany::One(number.to_string()))
    }

    fn visit_bool<E>(self, truth: bool) -> Result<OneOrMany, E> {
        Ok(OneOrMany::One(truth.to_string()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<OneOrMany, A::Error> {
        let mut words = Vec::new();
        while let Some(word) = list.next_element()? {
            words.push(word);
        }
        Ok(OneOrMany::Many(words))
    }
}

impl<'de> Deserialize<'de> for RawModel {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Spanned { value, referenced, .. } = Spanned::<Unplaced>::deserialize(deserializer)?;
        Ok(match value {
            Unplaced::Name(text) => Self { kind: Word { line: referenced.line(), text }, parameters: Vec::new() },
            Unplaced::Model(model) => model,
        })
    }
}

enum Unplaced {
    Name(String),
    Model(RawModel),
}

impl<'de> Deserialize<'de> for Unplaced {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ModelVisitor)
    }
}

struct ModelVisitor;

impl<'de> Visitor<'de> for ModelVisitor {
    type Value = Unplaced;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a model, alone or with its parameters, as in histogram: {bins: 24}")
    }

    fn visit_str<E>(self, name: &str) -> Result<Unplaced, E> {
        Ok(Unplaced::Name(name.to_owned()))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Unplaced, A::Error> {
        let Some((kind, Parameters(parameters))) = map.next_entry::<Word, Parameters>()? else {
            return Err(A::Error::custom("a model without a name: write one, as in histogram: {bins: 24}"));
        };
        match map.next_key::<Word>()? {
            None => Ok(Unplaced::Model(RawModel { kind, parameters })),
            Some(other) => Err(A::Error::custom(format!(
                "{:?} beside the model {:?}: begin each model with a dash of its own, and write its parameters in \
                 braces or indented below it",
                other.text, kind.text
            ))),
        }
    }
}

/// The parameters of a model; empty if the file has none.
struct Parameters(Vec<(Word, Words)>);

impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ParametersVisitor)
    }
}

struct ParametersVisitor;

impl<'de> Visitor<'de> for ParametersVisitor {
    type Value = Parameters;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("parameters with their values, as in {bins: 24}")
    }

    fn visit_unit<E>(self) -> Result<Parameters, E> {
        Ok(Parameters(Vec::new()))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Parameters, A::Error> {
        let mut parameters = Vec::new();
        while let Some(entry) = map.next_entry()? {
            parameters.push(entry);
        }
        Ok(Parameters(parameters))
    }
}
