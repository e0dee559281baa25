//! `tidemapd-planted-fault`: the daemon with the fault "acknowledge before fdatasync". The durability tests must catch
//! it; if they do not, they prove nothing about the real daemon.
//!
//! The fault is a disk, not a feature of the daemon: appends to a log return at once and reach the file only later. So
//! `tidemapd` has no code for it in any build, nobody can switch it on, and this program links the libraries that the
//! tests have built anyway.
//!
//! Invariant: only logs are late. A read waits for what is late, so that the daemon behaves like the real one until it
//! is killed.

mod late_disk;

use std::{process::ExitCode, sync::Arc};

use late_disk::LateDisk;

fn main() -> ExitCode {
    eprintln!("tidemapd-planted-fault: this daemon loses acknowledged observations; it is for tests only");
    tidemapd::run(Arc::new(LateDisk::default()))
}
