//! Tests that every reader must pass.
//!
//! Invariant: readers refuse every truncated file, and never panic on a changed one.

use super::error::FormatError;

/// Reads a valid file truncated at every byte, and expects an error with a message.
#[track_caller]
pub(crate) fn every_cut_is_refused<T: std::fmt::Debug>(whole: &[u8], read: impl Fn(&[u8]) -> Result<T, FormatError>) {
    assert!(read(whole).is_ok(), "the whole file can be read");
    for length in 0..whole.len() {
        match read(&whole[..length]) {
            Ok(result) => panic!("cut off at byte {length} of {}: {result:?}", whole.len()),
            Err(error) => assert!(error.to_string().len() > 20, "{error}"),
        }
    }
}

/// Reads a valid file with each byte replaced by several others, and expects no panic.
pub(crate) fn no_change_panics<T>(whole: &[u8], read: impl Fn(&[u8]) -> Result<T, FormatError>) {
    for at in 0..whole.len() {
        for byte in [0, 1, b' ', b'\n', b'-', b'0', b'9', 0x7f, 0x80, 0xff, whole[at].wrapping_add(1)] {
            let mut changed = whole.to_vec();
            changed[at] = byte;
            let _ = read(&changed);
        }
    }
}
