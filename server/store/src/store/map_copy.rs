//! Copies of one map between stores: what one of them gives, and how another one takes it.
//!
//! A copy has the newest checkpoint, the log from where that checkpoint needs it, and the history. It goes in parts,
//! file after file, with names like those within the folder of a map. The number of the map is that of the store that
//! takes it, so that the headers of the files are written anew; everything behind them stays as it is.
//!
//! Invariant: a name leads only to a file that the folder of a map may have. A copy becomes a map only when all of it
//! is durable and was checked.

use std::{collections::BTreeSet, io, path::PathBuf};

use crate::{
    checkpoint,
    error::{HistoryError, OpenError, StoreError, shown},
    history,
    log::segment_position,
};

mod arriving;
mod install;
mod source;

pub use install::MapCopy;
pub(crate) use install::complete;
pub use source::CopySource;

/// Limit of a part, in bytes.
pub const COPY_PART_BYTES: usize = 1 << 20;

/// A part of a file of a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CopyPart {
    /// The file, within the folder of the map, as `log/…`, `checkpoints/…` or `history/…`.
    pub name: String,
    /// The place where the part begins in the file.
    pub offset: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
    /// Whether the file ends with it.
    pub is_last: bool,
}

/// The amount of data in a copy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CopyTotal {
    /// Files.
    pub files: u64,
    /// Bytes of all files.
    pub bytes: u64,
}

/// Why there is no copy of a map.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum CopyError {
    /// The data that came is not a copy of a map.
    #[error("the copy is not valid: {name}: {reason}")]
    Invalid { name: String, reason: String },
    /// The map has no checkpoint that can be read, and its log begins behind its first record.
    #[error("{} holds no checkpoint that can be read, and the log begins behind its first record", shown(.0))]
    NoCheckpoint(PathBuf),
    /// A file of the copy cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A copy that counts cannot take the place of the map that it replaces.
    #[error("{0}; the next start puts the copy in its place")]
    Unfinished(#[source] StoreError),
    /// A file of the map cannot be read.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The history cannot be read.
    #[error(transparent)]
    History(#[from] HistoryError),
}

fn invalid(name: &str, reason: impl Into<String>) -> CopyError {
    CopyError::Invalid { name: name.chars().take(80).collect(), reason: reason.into() }
}

/// The kind of a file of a copy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CopiedFile {
    Segment,
    Checkpoint,
    History,
}

impl CopiedFile {
    const ALL: [CopiedFile; 3] = [CopiedFile::Segment, CopiedFile::Checkpoint, CopiedFile::History];

    /// Folder of the file within that of the map.
    fn folder(self) -> &'static str {
        match self {
            CopiedFile::Segment => "log",
            CopiedFile::Checkpoint => "checkpoints",
            CopiedFile::History => "history",
        }
    }

    /// The kind of a file of this name; `None`: the folder of a map has no such file.
    fn named(name: &str) -> Option<CopiedFile> {
        let (folder, file) = name.split_once('/')?;
        let kind = CopiedFile::ALL.into_iter().find(|kind| kind.folder() == folder)?;
        let is_known = match kind {
            CopiedFile::Segment => segment_position(file).is_some(),
            CopiedFile::Checkpoint => checkpoint::position(file).is_some(),
            CopiedFile::History => history::is_file(file),
        };
        is_known.then_some(kind)
    }
}

/// The names that have come, each once.
#[derive(Debug, Default)]
struct ArrivedNames(BTreeSet<String>);

impl ArrivedNames {
    fn add(&mut self, name: &str) -> Result<(), CopyError> {
        if self.0.insert(name.to_owned()) { Ok(()) } else { Err(invalid(name, "it was sent twice")) }
    }

    fn count(&self, kind: CopiedFile) -> usize {
        self.0.iter().filter(|name| CopiedFile::named(name) == Some(kind)).count()
    }
}

fn cut_off() -> io::Error {
    io::ErrorKind::UnexpectedEof.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_that_the_folder_of_a_map_may_have_are_taken() {
        for (name, kind) in [
            ("log/00000000000000000001.log", Some(CopiedFile::Segment)),
            ("checkpoints/00000000000000000009.tmc", Some(CopiedFile::Checkpoint)),
            ("history/00000000000000000002.states.tmh", Some(CopiedFile::History)),
            ("history/00000000000000000002.grid.tmh", Some(CopiedFile::History)),
        ] {
            assert_eq!(CopiedFile::named(name), kind, "{name}");
        }
        for name in [
            "",
            "MAP",
            "SHARED",
            "log",
            "log/",
            "log/NEWEST",
            "log/1.log",
            "log/../00000000000000000001.log",
            "../log/00000000000000000001.log",
            "/log/00000000000000000001.log",
            "log//00000000000000000001.log",
            "log/+0000000000000000001.log",
            "log/00000000000000000001.tmc",
            "forks/00000000000000000001.log",
            "checkpoints/00000000000000000009.tmc.new",
            "history/00000000000000000002.other.tmh",
        ] {
            assert_eq!(CopiedFile::named(name), None, "{name}");
        }
    }
}
