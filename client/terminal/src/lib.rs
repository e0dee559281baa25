//! What tidemap's programs write on a terminal: results on stdout, everything else on stderr.
//!
//! Invariant: no program of tidemap writes to stdout or stderr in another way, so that what is not printable never
//! reaches a terminal.

pub mod failure;
pub mod output;
pub mod progress;
