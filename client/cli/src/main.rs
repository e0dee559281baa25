//! `tidemap`, the command line.
//!
//! Invariant: all code is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    tidemap_cli::main()
}
