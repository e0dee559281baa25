//! The failure of a command.
//!
//! Invariant: a wrong command line is an error of its own type, because scripts rely on its exit status, 2.

use std::io;

/// A command whose arguments are valid one by one, but not together.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// A [`UsageError`] as the error of a command.
pub fn usage(text: impl Into<String>) -> anyhow::Error {
    UsageError(text.into()).into()
}

/// Whether stdout was closed. This is no failure: its reader has stopped reading on purpose.
#[must_use]
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .any(|cause| cause.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe))
}
