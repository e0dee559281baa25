//! `tidemap`, the command line.
//!
//! Invariant: the library has all of it.

use std::process::ExitCode;

fn main() -> ExitCode {
    tidemap_cli::main()
}
