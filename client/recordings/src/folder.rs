//! The folder of a recording of rosbag2: its `metadata.yaml`.
//!
//! Invariant: a name of a file stays within the folder.

use std::path::{Component, Path};

use serde::Deserialize;

use crate::{chunk::shortened, recording::RecordingError};

/// Name of the file that describes the folder.
pub const METADATA_NAME: &str = "metadata.yaml";
/// Maximum number of bytes of that file.
pub const METADATA_BYTES_MAX: usize = 4 << 20;
/// End of the names of files that are compressed as a whole. [`ZstdStream`](crate::zstd_stream::ZstdStream) reads them.
pub const ZSTD_ENDING: &str = ".zstd";

/// Ends of the names of the files of recordings.
const ENDINGS: [&str; 4] = [".db3", ".mcap", ".db3.zstd", ".mcap.zstd"];

/// Before this version, the name of the folder stands before the names of its files.
const VERSION_WITH_RELATIVE_NAMES: i64 = 4;

/// The content of `metadata.yaml`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Folder {
    /// The storage format of the files, such as `sqlite3` or `mcap`.
    pub storage: String,
    /// Names of the files within the folder, in the order of the recording.
    pub files: Vec<String>,
    /// The parts that are compressed with zstd.
    pub compression: Compression,
}

/// The parts of a recording of rosbag2 that are compressed with zstd.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// Nothing, or chunks within the files.
    None,
    /// Each message. The readers detect this themselves.
    Message,
    /// Each file as a whole.
    File,
}

#[derive(Deserialize)]
struct Document {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    #[serde(default)]
    version: i64,
    #[serde(default)]
    storage_identifier: String,
    #[serde(default)]
    relative_file_paths: Vec<String>,
    #[serde(default)]
    compression_format: String,
    #[serde(default)]
    compression_mode: String,
}

impl Folder {
    /// Takes the text of `metadata.yaml`.
    ///
    /// # Errors
    /// If it is no such text, is longer than [`METADATA_BYTES_MAX`], lists no file or one outside of the folder, or
    /// names a compression that is not known.
    pub fn parse(text: &str) -> Result<Self, RecordingError> {
        if text.len() > METADATA_BYTES_MAX {
            let what = METADATA_NAME.to_owned();
            return Err(RecordingError::TooLarge { what, bytes: text.len() as u64, max: METADATA_BYTES_MAX });
        }
        let document: Document = serde_saphyr::from_str(text)
            .map_err(|error| RecordingError::Broken(format!("{METADATA_NAME} is none of rosbag2: {error}")))?;
        let information = document.rosbag2_bagfile_information;
        let compression = compression(&information)?;
        let version = information.version;
        let files: Vec<String> = information
            .relative_file_paths
            .into_iter()
            .map(|path| file_name(path, version))
            .collect::<Result<_, _>>()?;
        if files.is_empty() {
            return Err(RecordingError::Broken(format!(
                "{METADATA_NAME} lists no files under relative_file_paths: the recorder did not end; run \
                 `ros2 bag reindex` on the folder, or name the file itself"
            )));
        }
        Ok(Self { storage: information.storage_identifier, files, compression })
    }
}

/// A listed name that is missing, and the file that is taken in its place.
pub type Renamed = (String, String);

/// Names of a recording's files in a folder, for the names that its `metadata.yaml` lists: files may have been renamed.
/// `present`: the files of the folder, those inside of its own folders left out. The second value has the pairs of a
/// listed name that is missing, and the file that is taken in its place.
///
/// # Errors
/// Listed files are missing, and it is not clear which others they are.
pub fn renamed(listed: Vec<String>, present: &[String]) -> Result<(Vec<String>, Vec<Renamed>), RecordingError> {
    let is_there = |name: &String| present.contains(name) || name.contains('/');
    let missing: Vec<&String> = listed.iter().filter(|name| !is_there(name)).collect();
    if missing.is_empty() {
        return Ok((listed, Vec::new()));
    }
    let is_other = |name: &&String| !listed.contains(name) && ENDINGS.iter().any(|ending| name.ends_with(ending));
    let mut others: Vec<&String> = present.iter().filter(is_other).collect();
    others.sort_by_key(|name| (last_number(name), (*name).clone()));
    // Several files are in the order of the numbers in their names.
    let numbers: Vec<Option<u64>> = others.iter().map(|name| last_number(name)).collect();
    let is_ordered = others.len() == 1 || numbers.windows(2).all(|pair| pair[0].is_some() && pair[0] < pair[1]);
    if others.len() != missing.len() || !is_ordered {
        let names = |names: &[&String]| {
            let names: Vec<&str> = names.iter().take(10).map(|name| name.as_str()).collect();
            if names.is_empty() { "no other recording".to_owned() } else { names.join(", ") }
        };
        return Err(RecordingError::Broken(format!(
            "{METADATA_NAME} lists {}, which the folder does not have; it has {}: name the files themselves",
            names(&missing),
            names(&others)
        )));
    }
    let pairs: Vec<Renamed> = missing.into_iter().cloned().zip(others.into_iter().cloned()).collect();
    let now = |name: String| pairs.iter().find(|(before, _)| *before == name).map_or(name, |(_, now)| now.clone());
    Ok((listed.iter().cloned().map(now).collect(), pairs))
}

/// The last number in a name, before its endings: rosbag2 numbers the files of a recording.
fn last_number(name: &str) -> Option<u64> {
    let stem = name.split('.').next().unwrap_or(name);
    let digits = stem.len() - stem.bytes().rev().take_while(u8::is_ascii_digit).count();
    stem.get(digits..)?.parse().ok()
}

fn compression(information: &Information) -> Result<Compression, RecordingError> {
    let mode = match information.compression_mode.to_ascii_uppercase().as_str() {
        "" | "NONE" => return Ok(Compression::None),
        "MESSAGE" => Compression::Message,
        "FILE" => Compression::File,
        _ => {
            let mode = shortened(&information.compression_mode);
            return Err(RecordingError::Unknown(format!(
                "{METADATA_NAME} has the compression_mode {mode:?}; NONE, MESSAGE and FILE are known"
            )));
        }
    };
    if information.compression_format != "zstd" {
        let format = shortened(&information.compression_format);
        return Err(RecordingError::Unknown(format!(
            "{METADATA_NAME} has the compression_format {format:?}; only \"zstd\" is read: convert the recording with \
             `ros2 bag convert`"
        )));
    }
    Ok(mode)
}

fn file_name(path: String, version: i64) -> Result<String, RecordingError> {
    let is_inside = Path::new(&path).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let last = Path::new(&path).file_name().and_then(|name| name.to_str());
    match last {
        Some(last) if is_inside && version < VERSION_WITH_RELATIVE_NAMES => Ok(last.to_owned()),
        Some(_) if is_inside => Ok(path),
        _ => Err(RecordingError::Broken(format!(
            "{METADATA_NAME} lists the file {:?}, which is not inside of the folder",
            shortened(&path)
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(version: i64, files: &str, compression: &str) -> String {
        format!(
            "rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: mcap\n  message_count: 3\n  \
             relative_file_paths:\n{files}\n{compression}\n  topics_with_message_count:\n    - topic_metadata:\n        \
             name: /scan\n        offered_qos_profiles: []\n"
        )
    }

    #[test]
    fn files_come_in_their_order() {
        let folder =
            Folder::parse(&text(9, "    - walk_1.mcap\n    - walk_0.mcap", "  compression_mode: \"\"")).unwrap();
        let files = vec!["walk_1.mcap".to_owned(), "walk_0.mcap".to_owned()];
        assert_eq!(folder, Folder { storage: "mcap".to_owned(), files, compression: Compression::None });
    }

    #[test]
    fn old_names_lose_their_folder() {
        let folder = Folder::parse(&text(3, "    - walk/walk_0.db3", "")).unwrap();
        assert_eq!(folder.files, ["walk_0.db3"]);
    }

    #[test]
    fn the_compression_is_known_or_refused() {
        let with = |lines: &str| Folder::parse(&text(5, "    - a.mcap.zstd", lines)).map(|folder| folder.compression);
        let file = with("  compression_format: zstd\n  compression_mode: FILE").unwrap();
        assert_eq!(file, Compression::File);
        let message = with("  compression_format: zstd\n  compression_mode: message").unwrap();
        assert_eq!(message, Compression::Message);
        let error = with("  compression_format: lz4\n  compression_mode: FILE").unwrap_err().to_string();
        assert!(error.contains("\"lz4\""), "{error}");
        let error = with("  compression_mode: BOTH").unwrap_err().to_string();
        assert!(error.contains("\"BOTH\""), "{error}");
    }

    #[test]
    fn files_outside_of_the_folder_are_refused() {
        for path in ["../a.mcap", "/a.mcap", "b/../../a.mcap", ".."] {
            for version in [3, 9] {
                let error = Folder::parse(&text(version, &format!("    - {path}"), "")).unwrap_err().to_string();
                assert!(error.contains("not inside"), "{path}: {error}");
            }
        }
    }

    #[test]
    fn renamed_files_are_found_where_it_is_clear_which_they_are() {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let found = |listed: &[&str], present: &[&str]| {
            renamed(names(listed), &names(present)).map(|(files, _)| files).map_err(|error| error.to_string())
        };
        assert_eq!(found(&["a_0.db3"], &["metadata.yaml", "a_0.db3"]), Ok(names(&["a_0.db3"])));
        assert_eq!(found(&["a_0.db3"], &["metadata.yaml", "monday.db3", "monday.db3-wal"]), Ok(names(&["monday.db3"])));
        let listed = ["a_0.mcap", "a_1.mcap", "a_2.mcap"];
        assert_eq!(
            found(&listed, &["b_2.mcap", "a_1.mcap", "b_10.mcap"]),
            Ok(names(&["b_2.mcap", "a_1.mcap", "b_10.mcap"]))
        );
        for (listed, present) in [
            (&["a_0.db3"][..], &["b_0.db3", "c_0.db3"][..]),
            (&["a_0.db3", "a_1.db3"], &["left.db3", "right.db3"]),
            (&["a_0.db3"], &["notes.txt"]),
        ] {
            let error = found(listed, present).unwrap_err();
            assert!(error.contains("metadata.yaml lists a_0.db3") && error.contains("name the files"), "{error}");
        }
    }

    #[test]
    fn a_text_without_files_gives_an_error_with_advice() {
        let error = Folder::parse("rosbag2_bagfile_information: {version: 9}").unwrap_err().to_string();
        assert!(error.contains("ros2 bag reindex"), "{error}");
        assert!(matches!(Folder::parse("image: map.pgm"), Err(RecordingError::Broken(_))));
    }
}
