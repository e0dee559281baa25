//! Files that commands read and write whole.
//!
//! Invariant: an error names its file.

use std::{fs, io, path::Path};

use anyhow::Context as _;

use super::UsageError;

/// Reads a text file, or stdin if the path is `-`.
pub(crate) fn read_text(path: &Path) -> anyhow::Result<String> {
    if path.as_os_str() == "-" {
        return io::read_to_string(io::stdin().lock()).context("stdin");
    }
    fs::read_to_string(path).with_context(|| path.display().to_string())
}

/// Writes a file.
pub(crate) fn write(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    fs::write(path, content).with_context(|| path.display().to_string())
}

/// The ending of a file's name, in small letters.
pub(crate) fn ending(path: &Path) -> Option<String> {
    path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase())
}

/// Refuses a picture whose name does not end in .svg.
pub(crate) fn check_picture(path: Option<&Path>) -> Result<(), UsageError> {
    match path {
        Some(path) if ending(path).as_deref() != Some("svg") => {
            Err(UsageError(format!("--picture {}: its ending has to be .svg", path.display())))
        }
        _ => Ok(()),
    }
}
