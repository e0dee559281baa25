//! Why a protocol is refused.
//!
//! Invariant: a message names line and key, the value found, and the values allowed.

use std::io;

use super::raw::Word;

/// Why a protocol is refused.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum ProtocolError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file is too long for a protocol.
    #[error("the file has {found} bytes, and a protocol has at most {max}; is it a file of data?")]
    TooLong { found: u64, max: u64 },
    /// The file is not YAML, or has unknown keys.
    #[error("{0}")]
    Yaml(String),
    /// A required key is missing.
    #[error("key {key} is missing: write {right}")]
    Missing { key: &'static str, right: String },
    /// A value is not allowed.
    #[error("line {line}: {key} is {found:?}: it has to be {right}")]
    Value { line: u64, key: String, found: String, right: String },
    /// The parameters of a model exclude each other, or a list of values has no tuning to choose from it.
    #[error("line {line}: model {model}: {wrong}")]
    Model { line: u64, model: String, wrong: String },
}

impl ProtocolError {
    /// An error of the YAML parser, which names the line itself.
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

    /// Whether the file could be read, so that the error is in its content.
    pub fn is_misuse(&self) -> bool {
        !matches!(self, Self::Io(_))
    }
}
