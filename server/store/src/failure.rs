//! Why a file or the index cannot be read: it is damaged, or the disk or the machine refuses.
//!
//! Invariant: an error of the disk or the machine is no damage. The contents of the file may be sound then, and it
//! stays where it is. sled keeps of some errors only their text, which contains the number of the system's error.

use std::{fmt, io};

use crate::error::{is_of_machine, is_of_machine_code, is_shortage};

/// Why a file or the index cannot be read or written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ReadFailure {
    /// The contents are damaged.
    Damaged(String),
    /// The disk or the machine returned an error, which gives no information about the contents.
    Disk(String),
}

/// Words before the number of an error, as `std` shows and debugs an [`io::Error`].
const BEFORE_CODE: [&str; 2] = ["os error ", "code: "];

/// The number of the system's error in the text of one.
fn code_in(text: &str) -> Option<i32> {
    BEFORE_CODE.iter().find_map(|word| {
        let (_, after) = text.split_once(word)?;
        let end = after.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(after.len());
        after.get(..end)?.parse().ok()
    })
}

impl ReadFailure {
    /// Returns the failure by the text of an error, or of a panic of sled.
    pub(crate) fn of_text(text: String) -> ReadFailure {
        if code_in(&text).is_some_and(is_of_machine_code) {
            ReadFailure::Disk(text)
        } else {
            ReadFailure::Damaged(text)
        }
    }

    /// The error, where the machine lacks something for now: memory or descriptors.
    pub(crate) fn shortage(&self) -> Option<io::Error> {
        let ReadFailure::Disk(text) = self else { return None };
        code_in(text).map(io::Error::from_raw_os_error).filter(is_shortage)
    }
}

impl fmt::Display for ReadFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (ReadFailure::Damaged(reason) | ReadFailure::Disk(reason)) = self;
        f.write_str(reason)
    }
}

impl From<String> for ReadFailure {
    fn from(reason: String) -> Self {
        ReadFailure::Damaged(reason)
    }
}

impl From<&str> for ReadFailure {
    fn from(reason: &str) -> Self {
        ReadFailure::Damaged(reason.to_owned())
    }
}

impl From<ReadFailure> for String {
    fn from(failure: ReadFailure) -> Self {
        let (ReadFailure::Damaged(reason) | ReadFailure::Disk(reason)) = failure;
        reason
    }
}

impl From<io::Error> for ReadFailure {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::UnexpectedEof {
            return ReadFailure::Damaged("it is cut off".to_owned());
        }
        if is_of_machine(&error) {
            ReadFailure::Disk(error.to_string())
        } else {
            ReadFailure::of_text(error.to_string())
        }
    }
}

impl From<sled::Error> for ReadFailure {
    fn from(error: sled::Error) -> Self {
        match error {
            sled::Error::Io(error) => error.into(),
            other => ReadFailure::of_text(other.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use rustix::io::Errno;

    use super::*;

    #[test]
    fn an_error_of_the_disk_or_the_machine_is_no_damage() {
        let refusals = [
            Errno::NOSPC,
            Errno::DQUOT,
            Errno::ROFS,
            Errno::ACCESS,
            Errno::MFILE,
            Errno::NFILE,
            Errno::NOMEM,
            Errno::IO,
        ];
        for code in refusals {
            let error = || io::Error::from_raw_os_error(code.raw_os_error());
            assert!(matches!(ReadFailure::from(error()), ReadFailure::Disk(_)), "{code}");
            let of_sled = sled::Error::Io(error());
            // A clone keeps the kind of an error and its text.
            assert!(matches!(ReadFailure::from(of_sled.clone()), ReadFailure::Disk(_)), "{code}: a clone");
            assert!(matches!(ReadFailure::from(of_sled), ReadFailure::Disk(_)), "{code}");
            let panic = format!("sled panicked: called `Result::unwrap()` on an `Err` value: Io({:?})", error());
            assert!(matches!(ReadFailure::of_text(panic), ReadFailure::Disk(_)), "{code}: a panic");
        }
        for code in [Errno::NOENT, Errno::NOTDIR, Errno::ISDIR, Errno::INVAL] {
            let error = io::Error::from_raw_os_error(code.raw_os_error());
            assert!(matches!(ReadFailure::from(error), ReadFailure::Damaged(_)), "{code}");
        }
        let cut = io::Error::from(io::ErrorKind::UnexpectedEof);
        assert!(matches!(ReadFailure::from(cut), ReadFailure::Damaged(_)));
        assert!(matches!(ReadFailure::from(sled::Error::Unsupported("older".to_owned())), ReadFailure::Damaged(_)));
        assert!(matches!(ReadFailure::of_text("sled panicked: page 3".to_owned()), ReadFailure::Damaged(_)));
    }
}
