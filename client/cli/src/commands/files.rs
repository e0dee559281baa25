//! Files that commands read and write whole.
//!
//! Invariant: an error names its file.

use std::{
    fs,
    io::{self, Seek, SeekFrom, Write},
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
};

use anyhow::Context as _;

use tempfile::NamedTempFile;

use super::UsageError;
use crate::output;

/// The permissions of a new file, before the user's own mask is applied.
const MODE: u32 = 0o666;

/// Reads a text file, or stdin if the path is `-`.
pub fn read_text(path: &Path) -> anyhow::Result<String> {
    if path.as_os_str() == "-" {
        return io::read_to_string(io::stdin().lock()).context("stdin");
    }
    fs::read_to_string(path).with_context(|| path.display().to_string())
}

/// Writes a file.
pub(crate) fn write(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    fs::write(path, content).with_context(|| path.display().to_string())
}

/// Writes a file that appears under its name when it is complete; until then, a file of that name stays as it was.
pub(crate) fn replace(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let mut file = Replacement::begin(path)?;
    file.write_all(content.as_ref()).with_context(|| path.display().to_string())?;
    file.keep()
}

/// A file in progress, which takes its name in the end. Dropped before, it is removed.
#[derive(Debug)]
pub(crate) struct Replacement {
    path: PathBuf,
    file: NamedTempFile,
}

impl Replacement {
    /// Begins a temporary file beside the final one.
    pub(crate) fn begin(path: &Path) -> anyhow::Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        builder.prefix(".tidemap-").permissions(fs::Permissions::from_mode(MODE));
        let file = builder.tempfile_in(folder).with_context(|| path.display().to_string())?;
        Ok(Self { path: path.to_owned(), file })
    }

    /// Gives the file its name.
    pub(crate) fn keep(self) -> anyhow::Result<()> {
        let Self { path, file } = self;
        file.persist(&path).map(drop).with_context(|| path.display().to_string())
    }
}

impl Write for Replacement {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Replacement {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.file.seek(position)
    }
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

/// Where a drawing goes.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct DrawingArg {
    /// Draws the result: in the terminal, instead of the table, or as an SVG file. Without FILE it is the last option
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-")]
    picture: Option<PathBuf>,
}

impl DrawingArg {
    /// Refuses a file of another kind.
    pub(crate) fn check(&self) -> Result<(), UsageError> {
        match &self.picture {
            Some(path) if path.as_os_str() != "-" => check_picture(Some(path)),
            _ => Ok(()),
        }
    }

    /// Whether there is anything to draw.
    pub(crate) fn is_wanted(&self) -> bool {
        self.picture.is_some()
    }

    /// Whether the drawing takes the place of the table.
    pub(crate) fn is_in_terminal(&self) -> bool {
        self.picture.as_ref().is_some_and(|path| path.as_os_str() == "-")
    }

    /// Shows or writes the drawing.
    pub(crate) fn put(&self, text: impl FnOnce() -> String, svg: impl FnOnce() -> String) -> anyhow::Result<()> {
        match &self.picture {
            Some(path) if path.as_os_str() != "-" => write(path, svg()),
            Some(_) => Ok(output::print(&text())?),
            None => Ok(()),
        }
    }
}
