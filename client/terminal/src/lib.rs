//! The output of tidemap's programs on a terminal: results on stdout, everything else on stderr.
//!
//! Invariant: no program of tidemap writes to stdout or stderr in another way, so that unprintable characters never
//! reach a terminal.

pub mod failure;
pub mod output;
pub mod progress;
