//! Opens files of rows: text as it is, gzip unpacked. A file of another kind is refused with the command that takes it.
//!
//! Invariant: the content decides the kind of a file, not its name. No more bytes are read than a pipe has to give at
//! once.

use std::{
    fs::File,
    io::{self, BufRead as _, BufReader, Read},
    path::Path,
};

use anyhow::Context as _;
use flate2::bufread::MultiGzDecoder;

use crate::commands::usage;

const BUFFER_BYTES: usize = 256 * 1024;

/// A file that is being read.
pub(crate) type RowSource = BufReader<Box<dyn Read + Send>>;

/// Starts of files that are no rows, and the messages about them.
const KINDS: [(&[u8], &str); 21] = [
    (b"# .PCD", "is a point cloud (PCD): tidemap grid observe sends it"),
    (b"VERSION", "is a point cloud (PCD): tidemap grid observe sends it"),
    (b"ply\n", "is a point cloud (PLY): tidemap grid observe sends it"),
    (b"ply\r\n", "is a point cloud (PLY): tidemap grid observe sends it"),
    (b"P5\n", "is the image of a map (PGM): tidemap grid observe sends it with its .yaml file"),
    (b"P5 ", "is the image of a map (PGM): tidemap grid observe sends it with its .yaml file"),
    (b"P2\n", "is the image of a map (PGM): tidemap grid observe sends it with its .yaml file"),
    (b"# Octomap", "is an OctoMap: tidemap grid observe sends it"),
    (b"tidemap scans", "is a file of scans: tidemap grid observe sends it"),
    (b"\x89MCAP", RECORDING),
    (b"#ROSBAG", RECORDING),
    (b"SQLite format 3", DATABASE),
    (
        b"\x28\xb5\x2f\xfd",
        "is packed with zstd: zstd -dc FILE unpacks it, and - in place of FILE sends the data from stdin",
    ),
    (b"\xfd7zXZ", "is packed with xz: xz -dc FILE unpacks it, and - in place of FILE sends the data from stdin"),
    (b"BZh", "is packed with bzip2: bzip2 -dc FILE unpacks it, and - in place of FILE sends the data from stdin"),
    (b"PK\x03\x04", "is a spreadsheet or a ZIP archive: save it as CSV, or unpack it"),
    (b"PAR1", "is a Parquet file: write it as CSV, or send the frame with the Python package (Client.observe)"),
    (b"\x89PNG", "is a picture: observations are rows of CSV"),
    (b"\x89HDF", "is an HDF5 file: write it as CSV, or send the frame with the Python package (Client.observe)"),
    (b"%PDF", "is a PDF file: observations are rows of CSV"),
    (b"\x7fELF", "is a program: observations are rows of CSV"),
];

const RECORDING: &str = "is a recording of ROS, which tidemap does not read: write its values as CSV with the columns \
                         time,state,value, and its maps and clouds as files for tidemap grid observe";
const DATABASE: &str = "is an SQLite database, as of Home Assistant or of a ROS 2 recording: write the rows as CSV with \
                        the columns time,state,value";

/// Name of the file for messages.
pub(crate) fn display_name(path: &Path) -> String {
    if path.as_os_str() == "-" { "stdin".to_owned() } else { path.display().to_string() }
}

/// Opens a file, or stdin if the path is `-`. Returns it with its size; `None` for pipes and packed files.
///
/// # Errors
/// The file cannot be read, or has no rows.
pub(crate) fn open(path: &Path) -> anyhow::Result<(RowSource, Option<u64>)> {
    let shown = || display_name(path);
    let (source, total_bytes): (Box<dyn Read + Send>, _) = if path.as_os_str() == "-" {
        (Box::new(io::stdin()), None)
    } else {
        let file = File::open(path).with_context(shown)?;
        let total_bytes = file.metadata().ok().filter(|metadata| metadata.is_file()).map(|metadata| metadata.len());
        (Box::new(file), total_bytes)
    };
    let source = checked_start(source, path)?;
    Ok(match source {
        (source, true) => (source, None),
        (source, false) => (source, total_bytes),
    })
}

/// Checks the start of a file; unpacks gzip. Returns whether it was packed.
fn checked_start(source: Box<dyn Read + Send>, path: &Path) -> anyhow::Result<(RowSource, bool)> {
    let shown = || display_name(path);
    let mut source: RowSource = BufReader::with_capacity(BUFFER_BYTES, source);
    let is_packed = source.fill_buf().with_context(shown)?.starts_with(b"\x1f\x8b");
    if is_packed {
        let unpacked: Box<dyn Read + Send> = Box::new(MultiGzDecoder::new(source));
        source = BufReader::with_capacity(BUFFER_BYTES, unpacked);
    }
    match problem(source.fill_buf().with_context(shown)?) {
        None => Ok((source, is_packed)),
        Some(problem) => Err(usage(format!("{} {problem}", shown()))),
    }
}

/// The reason why the start of a file is not a start of rows.
fn problem(start: &[u8]) -> Option<String> {
    if let Some(encoding) = wide_text(start) {
        return Some(format!(
            "is text in {encoding}: save it as UTF-8, or send it with `iconv -f {encoding} -t UTF-8 FILE`, and - in \
             place of FILE"
        ));
    }
    let known = KINDS.iter().find(|(magic, _)| start.starts_with(magic)).map(|(_, what)| (*what).to_owned());
    known.or_else(|| yaml(start)).or_else(|| {
        let has_zero = start.iter().take(512).any(|&byte| byte == 0);
        has_zero.then(|| "is not text: observations are rows of CSV with the columns time,state,value".to_owned())
    })
}

/// The encoding of text that is not UTF-8, by its mark or by the zeros of its first letters.
fn wide_text(start: &[u8]) -> Option<&'static str> {
    match start {
        [0xff, 0xfe, 0, 0, ..] => Some("UTF-32LE"),
        [0, 0, 0xfe, 0xff, ..] => Some("UTF-32BE"),
        [0xff, 0xfe, ..] => Some("UTF-16LE"),
        [0xfe, 0xff, ..] => Some("UTF-16BE"),
        [b' '..=b'~', 0, b' '..=b'~', 0, ..] => Some("UTF-16LE"),
        [0, b' '..=b'~', 0, b' '..=b'~', ..] => Some("UTF-16BE"),
        _ => None,
    }
}

/// The message about YAML: a map server's file, or a topological map.
fn yaml(start: &[u8]) -> Option<String> {
    let start = &start[..start.len().min(4096)];
    let text = match std::str::from_utf8(start) {
        Ok(text) => text,
        Err(error) => std::str::from_utf8(start.get(..error.valid_up_to())?).ok()?,
    };
    let text = text.trim_start_matches('\u{feff}');
    let keys: Vec<&str> = text.lines().filter_map(|line| Some(line.split_once(':')?.0)).collect();
    let has = |key: &str| keys.contains(&key);
    if has("image") && has("resolution") {
        return Some("describes a map of Nav2's map server: tidemap grid observe sends it".to_owned());
    }
    let first =
        text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#') && *line != "---")?;
    let is_list = first.starts_with("- ") && first.contains(':');
    if has("nodes") || is_list || (has("meta") && has("metric_map")) {
        return Some("is YAML: tidemap topology load takes it if it is a topological map".to_owned());
    }
    // A header of CSV has commas; a first line of YAML has a key.
    let is_yaml = first.ends_with(':') || (first.contains(": ") && !first.contains(','));
    is_yaml.then(|| "is YAML: observations are rows of CSV with the columns time,state,value".to_owned())
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write as _};

    use flate2::{Compression, write::GzEncoder};

    use super::*;

    fn read(bytes: Vec<u8>) -> anyhow::Result<String> {
        let (mut source, _) = checked_start(Box::new(Cursor::new(bytes)), Path::new("log.csv"))?;
        let mut text = String::new();
        source.read_to_string(&mut text)?;
        Ok(text)
    }

    const ROWS: &str = "time,state,value\n1,door,0\n";

    #[test]
    fn rows_are_read_as_they_are_and_unpacked() -> anyhow::Result<()> {
        assert_eq!(read(ROWS.into())?, ROWS);
        assert_eq!(read(Vec::new())?, "");
        assert_eq!(read("\u{feff}time,state,value\n".into())?, "\u{feff}time,state,value\n");
        let pack = |text: &str| -> io::Result<Vec<u8>> {
            let mut packer = GzEncoder::new(Vec::new(), Compression::fast());
            packer.write_all(text.as_bytes())?;
            packer.finish()
        };
        let (first, second) = ROWS.split_at(20);
        // Two files packed one after the other are one.
        let packed = [pack(first)?, pack(second)?].concat();
        assert_eq!(read(packed.clone())?, ROWS);
        assert!(read(packed[..packed.len() - 3].to_vec()).is_err(), "a truncated file is an error");
        Ok(())
    }

    #[test]
    fn text_of_another_encoding_is_named() {
        let wide: Vec<u8> = ROWS.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let marked = [&[0xff, 0xfe][..], &wide].concat();
        for bytes in [wide, marked] {
            let error = read(bytes).expect_err("UTF-16").to_string();
            assert!(error.starts_with("log.csv is text in UTF-16LE") && error.contains("iconv"), "{error}");
        }
        let big: Vec<u8> = ROWS.encode_utf16().flat_map(u16::to_be_bytes).collect();
        assert!(read(big).expect_err("UTF-16").to_string().contains("UTF-16BE"));
    }

    #[test]
    fn files_of_other_kinds_name_their_command() {
        for (start, words) in [
            (&b"# .PCD v0.7 - Point Cloud\nVERSION 0.7\n"[..], "grid observe"),
            (b"ply\nformat ascii 1.0\n", "grid observe"),
            (b"P5\n# saved\n400 300\n255\n", "grid observe"),
            (b"# Octomap OcTree binary file\n", "grid observe"),
            (b"tidemap scans 1\n", "grid observe"),
            (b"image: hall.pgm\nmode: trinary\nresolution: 0.05\n", "grid observe"),
            (b"- meta: {map: flat}\n  node:\n", "topology load"),
            (b"meta:\n  last_updated: 2022\nmetric_map: hall\nnodes:\n- meta:\n", "topology load"),
            (b"robot:\n  name: spot\n", "is YAML"),
            (b"\x89MCAP0\r\n\x01", "recording of ROS"),
            (b"#ROSBAG V2.0\n", "recording of ROS"),
            (b"PK\x03\x04", "save it as CSV"),
            (b"\x01\x02\x00\x03", "is not text"),
        ] {
            let error = read(start.to_vec()).expect_err(words).to_string();
            assert!(error.starts_with("log.csv ") && error.contains(words), "{words}: {error}");
        }
        for rows in [
            "time;state;value\n",
            "time\tstate\tvalue\n",
            "Time: UTC,state,value\n",
            "1,2,3\n",
            "# notes\ntime,state,value\n",
        ] {
            assert!(read(rows.into()).is_ok(), "the header is judged by its reader: {rows}");
        }
    }
}
