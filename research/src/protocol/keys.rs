//! Reading of protocol files, and the checks of keys that all protocols share.
//!
//! Invariant: every error names the line, the key and the allowed values.

use std::{
    fmt, fs,
    ops::RangeInclusive,
    path::{Path, PathBuf},
    str::FromStr,
};

use serde::Deserialize;

use super::{ProtocolError, raw::Word};

/// Maximum length of a protocol; a long one has a hundred lines.
const FILE_BYTES_MAX: u64 = 1024 * 1024;

/// A protocol file that was read.
pub(crate) struct ProtocolFile {
    /// The content.
    pub(crate) text: String,
    /// The name without its ending: the name of the experiment if the protocol has none.
    pub(crate) name: String,
    /// The folder, from which paths in the protocol start.
    pub(crate) folder: PathBuf,
}

impl ProtocolFile {
    pub(crate) fn read(path: &Path) -> Result<Self, ProtocolError> {
        let length = fs::metadata(path)?.len();
        if length > FILE_BYTES_MAX {
            return Err(ProtocolError::TooLong { found: length, max: FILE_BYTES_MAX });
        }
        let name = path.file_stem().map_or_else(|| "experiment".into(), |stem| stem.to_string_lossy().into_owned());
        let folder = path.parent().unwrap_or_else(|| Path::new("")).to_owned();
        Ok(Self { text: fs::read_to_string(path)?, name, folder })
    }
}

/// The raw protocol of a text.
pub(crate) fn from_yaml<'de, T: Deserialize<'de>>(text: &'de str) -> Result<T, ProtocolError> {
    serde_saphyr::from_str(text).map_err(|error| ProtocolError::yaml(&error))
}

/// The text of a required key, which must not be empty.
pub(crate) fn required(word: Option<Word>, key: &'static str, right: &str) -> Result<Word, ProtocolError> {
    match word {
        Some(word) if word.text.is_empty() => Err(ProtocolError::value(key, &word, right)),
        Some(word) => Ok(word),
        None => Err(ProtocolError::missing(key, right)),
    }
}

/// The value of a word, or an error that lists the allowed values.
pub(crate) fn parsed<T>(
    word: &Word,
    key: &str,
    right: &str,
    read: impl FnOnce(&str) -> Option<T>,
) -> Result<T, ProtocolError> {
    read(&word.text).ok_or_else(|| ProtocolError::value(key, word, right))
}

/// A whole number within a range.
pub(crate) fn whole<T>(word: &Word, key: &str, range: RangeInclusive<T>) -> Result<T, ProtocolError>
where
    T: FromStr + PartialOrd + fmt::Display,
{
    let right = format!("a whole number from {} to {}", range.start(), range.end());
    parsed(word, key, &right, |text| text.parse().ok().filter(|number| range.contains(number)))
}
