//! `tidemap`, the command line.
//!
//! Invariant: results go to stdout, everything else to stderr. The exit status is 0 where all was done, 1 where
//! something failed or was refused, 2 where the command makes no sense, 130 after Ctrl-C.

mod commands;
mod demo;
mod output;
mod progress;

use std::{io, process::ExitCode};

use clap::Parser as _;

use commands::{CommandLine, UsageError};

fn main() -> ExitCode {
    let command_line = CommandLine::parse();
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return failed(&anyhow::Error::new(error).context("the runtime cannot start")),
    };
    let code = runtime.block_on(commands::run(command_line)).unwrap_or_else(|error| failed(&error));
    // A thread may still wait for stdin; it need not be waited for.
    runtime.shutdown_background();
    code
}

/// Says what went wrong, in one line. A reader of stdout that has gone away has what it wanted, and needs no word.
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
