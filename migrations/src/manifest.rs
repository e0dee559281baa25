//! The file `MANIFEST`: the disk format of a data directory and the identity of its store.
//!
//! It is readable text:
//!
//! ```text
//! tidemap store
//! format 1
//! store 00112233445566778899aabbccddeeff
//! crc32c 89abcdef
//! ```
//!
//! Invariant: in every format, past and future, the first line, the form of the second and that of the last are the
//! same and the last covers everything before it, so any version can distinguish "newer" from "damaged".

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

/// Name of the file within the data directory.
pub const FILE_NAME: &str = "MANIFEST";
/// Name under which a new manifest is written before it takes the place of the old one.
pub const NEW_FILE_NAME: &str = "MANIFEST.new";

const FIRST_LINE: &str = "tidemap store";
/// Limit of the file's length; longer files are not read.
const SIZE_MAX: u64 = 4096;

/// The manifest of a data directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Manifest {
    /// Disk format of the data directory, from 1.
    pub format: u32,
    /// The identity of the store: 32 lower-case hexadecimal digits.
    pub store_id: String,
}

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// The store's identity is not 16 bytes in hexadecimal.
    #[error("store id {0:?} is not valid: it must be 32 lower-case hexadecimal digits")]
    StoreId(String),
    /// The file is damaged.
    #[error(
        "{} is damaged: {reason}. Restore this file from a backup of the same data directory; do not write it by hand",
        .file.display()
    )]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Description of the damage.
        reason: &'static str,
    },
    /// A newer version of tidemap wrote the directory.
    #[error(
        "{} has disk format {found}, and this version supports formats up to {supported}: use a newer version of \
         tidemapd. Nothing has been changed",
        .file.display()
    )]
    TooNew {
        /// The file.
        file: PathBuf,
        /// The format of the directory.
        found: u32,
        /// The newest format that this version can read.
        supported: u32,
    },
    /// The file cannot be read or written.
    #[error("cannot read or write {}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Whether `id` is 16 bytes in lower-case hexadecimal.
pub fn is_store_id(id: &str) -> bool {
    id.len() == 32 && id.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// Reads the manifest of a data directory; `None` if there is none. Changes nothing.
///
/// # Errors
/// [`ManifestError`]: damaged, too new, or not readable.
pub fn read(directory: &Path, supported: u32) -> Result<Option<Manifest>, ManifestError> {
    let file = directory.join(FILE_NAME);
    let io_error = |source| ManifestError::Io { file: file.clone(), source };
    match fs::metadata(&file) {
        Ok(metadata) if metadata.len() > SIZE_MAX => {
            return Err(ManifestError::Damaged { file, reason: "it is too long" });
        }
        Ok(_) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(io_error(error)),
    }
    let bytes = fs::read(&file).map_err(io_error)?;
    let damaged = |reason| ManifestError::Damaged { file: file.clone(), reason };
    let text = std::str::from_utf8(&bytes).map_err(|_| damaged("it is not text"))?;
    let format = parse_format(text).map_err(damaged)?;
    if format > supported {
        return Err(ManifestError::TooNew { file, found: format, supported });
    }
    let store_id = text.lines().nth(2).and_then(|line| line.strip_prefix("store ")).unwrap_or_default();
    let manifest = Manifest { format, store_id: store_id.to_owned() };
    // Writing it again must give the same bytes, so that the file has no other content.
    if !is_store_id(store_id) || to_text(&manifest) != text {
        return Err(damaged("it has unexpected lines"));
    }
    Ok(Some(manifest))
}

/// Checks the parts that all formats have in common.
fn parse_format(text: &str) -> Result<u32, &'static str> {
    let body_length = text.rfind("crc32c ").ok_or("the checksum is missing")?;
    let (body, checksum) = text.split_at(body_length);
    if checksum != checksum_line(body) {
        return Err("its checksum does not match");
    }
    let mut lines = body.lines();
    if lines.next() != Some(FIRST_LINE) {
        return Err("the first line is not \"tidemap store\"");
    }
    let format = lines.next().and_then(|line| line.strip_prefix("format "));
    format.and_then(|number| number.parse().ok()).ok_or("the second line is not \"format NUMBER\"")
}

fn checksum_line(body: &str) -> String {
    format!("crc32c {:08x}\n", crc32c::crc32c(body.as_bytes()))
}

/// The text of a manifest.
pub fn to_text(manifest: &Manifest) -> String {
    let body = format!("{FIRST_LINE}\nformat {}\nstore {}\n", manifest.format, manifest.store_id);
    let checksum = checksum_line(&body);
    body + &checksum
}

/// Writes the manifest of a data directory: durable when this returns, and complete or absent at every moment before.
///
/// # Errors
/// [`ManifestError::StoreId`], or [`ManifestError::Io`].
pub fn write(directory: &Path, manifest: &Manifest) -> Result<(), ManifestError> {
    if !is_store_id(&manifest.store_id) {
        return Err(ManifestError::StoreId(manifest.store_id.clone()));
    }
    let new_file = directory.join(NEW_FILE_NAME);
    let replace = || {
        let mut file = File::create(&new_file)?;
        file.write_all(to_text(manifest).as_bytes())?;
        file.sync_all()?;
        fs::rename(&new_file, directory.join(FILE_NAME))?;
        File::open(directory)?.sync_all()
    };
    replace().map_err(|source| ManifestError::Io { file: new_file.clone(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: &str = "00112233445566778899aabbccddeeff";

    fn manifest(format: u32) -> Manifest {
        Manifest { format, store_id: ID.to_owned() }
    }

    #[test]
    fn what_is_written_is_read() {
        let directory = tempfile::tempdir().expect("temporary directory");
        assert_eq!(read(directory.path(), 1).expect("readable"), None);
        write(directory.path(), &manifest(1)).expect("writable");
        assert_eq!(read(directory.path(), 1).expect("readable"), Some(manifest(1)));
        assert!(!directory.path().join(NEW_FILE_NAME).exists());
    }

    #[test]
    fn format_1_is_written_like_this_for_ever() {
        let text = "tidemap store\nformat 1\nstore 00112233445566778899aabbccddeeff\ncrc32c d775b5c0\n";
        assert_eq!(to_text(&manifest(1)), text);
    }

    #[test]
    fn a_newer_format_is_distinguished_from_damage() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let body = "tidemap store\nformat 7\nsomething new\n";
        fs::write(directory.path().join(FILE_NAME), body.to_owned() + &checksum_line(body)).expect("writable");
        let error = read(directory.path(), 1).expect_err("too new");
        assert!(matches!(error, ManifestError::TooNew { found: 7, supported: 1, .. }), "{error}");
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let good = to_text(&manifest(1)).into_bytes();
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            fs::write(directory.path().join(FILE_NAME), &bad).expect("writable");
            let error = read(directory.path(), 1).expect_err("damaged");
            assert!(matches!(error, ManifestError::Damaged { .. }), "bit {bit}: {error}");
        }
        for length in 0..good.len() {
            fs::write(directory.path().join(FILE_NAME), &good[..length]).expect("writable");
            assert!(matches!(read(directory.path(), 1), Err(ManifestError::Damaged { .. })), "length {length}");
        }
    }

    #[test]
    fn a_store_id_is_sixteen_bytes_in_hexadecimal() {
        let directory = tempfile::tempdir().expect("temporary directory");
        for bad in ["", "0", "00112233445566778899AABBCCDDEEFF", "00112233445566778899aabbccddeef\n"] {
            let error = write(directory.path(), &Manifest { format: 1, store_id: bad.to_owned() });
            assert!(matches!(error, Err(ManifestError::StoreId(_))), "{bad:?}");
        }
        assert_eq!(fs::read_dir(directory.path()).expect("readable").count(), 0);
    }
}
