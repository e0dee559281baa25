//! `tidemap`, the command line.
//!
//! Invariant: results go to stdout, everything else to stderr. The exit status is 0 after success, 1 after a failure or
//! a refusal, 2 after a usage error, 130 after Ctrl-C.

mod commands;
mod demo;
mod output;
mod progress;

use std::{io, process::ExitCode};

use commands::UsageError;

fn main() -> ExitCode {
    let (command_line, subject) = commands::parse();
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return failed(&anyhow::Error::new(error).context("the runtime cannot start")),
    };
    let code = runtime.block_on(commands::run(command_line, &subject)).unwrap_or_else(|error| failed(&error));
    // A thread may still wait for stdin; do not wait for it.
    runtime.shutdown_background();
    code
}

/// Reports an error in one line. A closed stdout is no error: its reader has stopped reading on purpose.
fn failed(error: &anyhow::Error) -> ExitCode {
    let broken_pipe = |cause: &(dyn std::error::Error + 'static)| {
        cause.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
    };
    if error.chain().any(broken_pipe) {
        return ExitCode::SUCCESS;
    }
    progress::status_line(&format!("error: {error:#}"));
    if error.is::<UsageError>() { ExitCode::from(2) } else { ExitCode::FAILURE }
}
