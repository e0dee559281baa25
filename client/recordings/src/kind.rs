//! Detects which kind of file a recording is, and reads it.
//!
//! Invariant: the kind follows from the first bytes, never from the name. A file that is no recording gets a text that
//! states what to do with it.

use std::io::{Read, Seek};

use crate::{
    bag, mcap_file,
    recording::{Ending, FileKind, RecordingError, Sink},
    rosbag2, sqlite,
};

/// The number of first bytes of a file that [`FileKind::detect`] reads.
pub const DETECT_BYTES: usize = 512;

const UNPACK: &str = "this is a packed file: unpack it first, then import its content";

/// The first bytes of files of other kinds, and advice for them.
const OTHERS: [(&[u8], &str); 14] = [
    (b"version https://git-lfs.github.com/spec/", "this is only a pointer of Git LFS: run `git lfs pull` first"),
    (b"rosbag2_bagfile_information", "this describes a recording of rosbag2: give its folder instead"),
    (b"\x28\xb5\x2f\xfd", "this is compressed with zstd as a whole: run `zstd -d` on it first"),
    (b"\x1f\x8b", UNPACK),
    (b"PK\x03\x04", UNPACK),
    (b"\xfd7zXZ\x00", UNPACK),
    (b"BZh", UNPACK),
    (b"7z\xbc\xaf\x27\x1c", UNPACK),
    (b"\x89PNG\r\n\x1a\n", "this is a picture or a map, no recording: see `tidemap grid observe`"),
    (b"# .PCD", "this is a map or a scan, no recording: see `tidemap grid observe`"),
    (b"VERSION .7", "this is a map or a scan, no recording: see `tidemap grid observe`"),
    (b"ply\n", "this is a cloud of points, no recording"),
    (b"<!DOCTYPE", "this is a web page, no recording: fetch the file itself"),
    (b"<html", "this is a web page, no recording: fetch the file itself"),
];

impl FileKind {
    /// The kind of a file with these first bytes; give [`DETECT_BYTES`] of them, or the whole file. A file that ends
    /// within the first bytes of a kind is of that kind.
    ///
    /// # Errors
    /// [`RecordingError::Unknown`] with a text that states what the file probably is, and what to do.
    pub fn detect(bytes: &[u8]) -> Result<Self, RecordingError> {
        let kinds =
            [(&bag::MAGIC[..], Self::Bag), (&mcap_file::MAGIC[..], Self::Mcap), (&sqlite::MAGIC[..], Self::Sqlite)];
        // One byte is too little: the first of an MCAP is the first of a PNG too.
        let begins = |magic: &[u8]| bytes.starts_with(magic) || (bytes.len() >= 5 && magic.starts_with(bytes));
        if let Some((_, kind)) = kinds.into_iter().find(|(magic, _)| begins(magic)) {
            return Ok(kind);
        }
        Err(RecordingError::Unknown(what_it_is(bytes)))
    }
}

/// Reads a file of a kind.
///
/// # Errors
/// The errors of the reader of the kind.
pub fn read<R: Read + Seek>(kind: FileKind, source: R, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
    match kind {
        FileKind::Sqlite => rosbag2::read(source, sink),
        FileKind::Bag | FileKind::Mcap => read_stream(kind, source, sink),
    }
}

/// Reads a file of a kind that can only be read from the front to the back, such as one that is being decompressed.
///
/// # Errors
/// The errors of the reader of the kind; [`RecordingError::Unknown`] for SQLite, whose pages stand in no order.
pub fn read_stream<R: Read>(kind: FileKind, source: R, sink: &mut dyn Sink) -> Result<Ending, RecordingError> {
    match kind {
        FileKind::Bag => bag::read(source, sink),
        FileKind::Mcap => mcap_file::read(source, sink),
        FileKind::Sqlite => Err(RecordingError::Unknown(
            "an SQLite database cannot be read while it is decompressed: run `zstd -d` on the file first".to_owned(),
        )),
    }
}

fn what_it_is(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "the file is empty".to_owned();
    }
    if let Some(text) = bag::other_version(bytes) {
        return text;
    }
    if let Some((_, text)) = OTHERS.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return (*text).to_owned();
    }
    if bytes.get(257..262) == Some(b"ustar") {
        return UNPACK.to_owned();
    }
    if let [b'P', b'1'..=b'6', space, ..] = bytes
        && space.is_ascii_whitespace()
    {
        return "this is a picture or a map, no recording: see `tidemap grid observe`".to_owned();
    }
    let first_line = bytes.split(|byte| matches!(byte, b'\n' | b'\r')).next().unwrap_or_default();
    if first_line.contains(&b',') && first_line.iter().all(|byte| *byte >= b' ' || *byte == b'\t') {
        return "this seems to be a table in CSV, no recording: see `tidemap observe`".to_owned();
    }
    let first = bytes[..bytes.len().min(16)].escape_ascii();
    format!("this is no recording that is known: bags of ROS 1, rosbag2 and MCAP are read. It begins with \"{first}\"")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;
    use crate::{bag::tests::BagWriter, testing::KeptMessages, zstd_stream::ZstdStream};

    fn text(bytes: &[u8]) -> String {
        match FileKind::detect(bytes) {
            Err(RecordingError::Unknown(text)) => text,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn recordings_are_known_by_their_first_bytes() {
        assert_eq!(FileKind::detect(b"#ROSBAG V2.0\nE").unwrap(), FileKind::Bag);
        assert_eq!(FileKind::detect(b"\x89MCAP0\r\n\x01").unwrap(), FileKind::Mcap);
        assert_eq!(FileKind::detect(b"SQLite format 3\0\x10").unwrap(), FileKind::Sqlite);
        assert_eq!(FileKind::detect(b"#ROSBAG V").unwrap(), FileKind::Bag);
    }

    #[test]
    fn old_bags_are_refused_by_their_version() {
        assert!(text(b"#ROSRECORD V1.2\n\x01").contains("format ROSRECORD V1.2;"));
        assert!(text(b"#ROSBAG V1.1\n").contains("format ROSBAG V1.1;"));
        assert!(text(b"#ROSRECORD V1.2\n").contains("rosbag fix"));
    }

    #[test]
    fn other_files_get_a_hint() {
        for (bytes, hint) in [
            (&b"version https://git-lfs.github.com/spec/v1\noid"[..], "git lfs pull"),
            (b"rosbag2_bagfile_information:\n", "folder"),
            (b"\x28\xb5\x2f\xfd\x00", "zstd -d"),
            (b"\x1f\x8b\x08", "unpack it first"),
            (b"PK\x03\x04", "unpack it first"),
            (b"P5\n100 100\n255\n", "tidemap grid observe"),
            (b"\x89PNG\r\n\x1a\n", "tidemap grid observe"),
            (b"# .PCD v0.7", "tidemap grid observe"),
            (b"time,state,value\n0,door,1\n", "`tidemap observe`"),
            (b"", "empty"),
            (b"\x00\x01hello", "\\x00\\x01hello"),
        ] {
            assert!(text(bytes).contains(hint), "{hint}: {}", text(bytes));
        }
    }

    #[test]
    fn a_file_that_is_compressed_as_a_whole_is_read_while_it_is_decompressed() {
        let plain = BagWriter::default().write(&vec![vec![(0, (10, 5), vec![1, 2])]]);
        let packed = compress_to_vec(&plain[..], CompressionLevel::Fastest);
        let read_packed = |bytes: &[u8]| {
            let mut kept = KeptMessages::default();
            let ending = read_stream(FileKind::Bag, ZstdStream::new(bytes), &mut kept);
            (kept.messages, ending.unwrap())
        };
        let messages = vec![(0, 10_000_000_005, vec![1, 2])];
        assert_eq!(read_packed(&packed), (messages, Ending::Whole));
        let (messages, ending) = read_packed(&packed[..packed.len() / 2]);
        assert!(messages.is_empty() && matches!(ending, Ending::CutOff(_)), "{ending:?}");
    }

    #[test]
    fn a_database_is_not_read_as_a_stream() {
        let error = read_stream(FileKind::Sqlite, &b""[..], &mut KeptMessages::default()).unwrap_err();
        assert!(error.to_string().contains("zstd -d"), "{error}");
    }

    proptest! {
        #[test]
        fn any_first_bytes_are_taken(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = FileKind::detect(&bytes);
        }
    }
}
