//! What can be wrong with a protocol.
//!
//! Invariant: a message names line and key, what was found, and what would be right.

use std::io;

use super::raw::Word;

/// Why a protocol was refused.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    /// It cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It is no protocol.
    #[error("the file has {found} bytes, and a protocol has at most {most}; is it a file of data?")]
    TooLong {
        /// Its length.
        found: u64,
        /// The most.
        most: u64,
    },
    /// It is not YAML, or has a key or a shape that no protocol has.
    #[error("{0}")]
    Yaml(String),
    /// A key that has to be there.
    #[error("key {key} is missing: write {right}")]
    Missing {
        /// Which.
        key: &'static str,
        /// What would be right.
        right: String,
    },
    /// A value that may not be.
    #[error("line {line}: {key} is {found:?}: it has to be {right}")]
    Value {
        /// Of the value, from 1.
        line: u64,
        /// Which key.
        key: String,
        /// What was written.
        found: String,
        /// What would be right.
        right: String,
    },
    /// A model with parameters that do not go together, or a list that nothing chooses from.
    #[error("line {line}: model {model}: {wrong}")]
    Model {
        /// Of the model or its parameter, from 1.
        line: u64,
        /// Which model.
        model: String,
        /// What is wrong, and what would be right.
        wrong: String,
    },
}

impl ProtocolError {
    /// From the parser, which says the line itself.
    pub(crate) fn yaml(error: &serde_saphyr::Error) -> Self {
        let message = error.without_snippet().to_string();
        Self::Yaml(message.trim_start_matches("error: ").lines().collect::<Vec<_>>().join(" "))
    }

    pub(crate) fn missing(key: &'static str, right: &str) -> Self {
        Self::Missing { key, right: right.to_owned() }
    }

    pub(crate) fn value(key: &str, word: &Word, right: &str) -> Self {
        let found: String = word.text.chars().take(80).collect();
        Self::Value { line: word.line, key: key.to_owned(), found, right: right.to_owned() }
    }

    pub(crate) fn model(line: u64, model: &Word, wrong: impl Into<String>) -> Self {
        Self::Model { line, model: model.text.clone(), wrong: wrong.into() }
    }

    /// Whether the file is there and says something wrong, in contrast to one that cannot be read.
    pub fn is_misuse(&self) -> bool {
        !matches!(self, Self::Io(_))
    }
}
