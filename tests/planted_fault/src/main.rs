//! `tidemapd-planted-fault`: the daemon with a fault, by default "acknowledge before fdatasync"; `TIDEMAP_PLANTED_FAULT`
//! names another one. The durability tests must catch each; if they do not, they prove nothing about the real daemon.
//!
//! A fault is a disk, not a feature of the daemon; by default appends to a log return at once and reach the file only
//! later. So `tidemapd` has no code for it in any build, nobody can switch it on, and this program links the libraries that the
//! tests have built anyway.
//!
//! Invariant: only logs are late. A read waits for what is late, so that the daemon behaves like the real one until it
//! is killed.

mod faulty_disk;
mod late_disk;

use std::{process::ExitCode, sync::Arc};

use faulty_disk::{Fault, FaultyDisk};
use late_disk::LateDisk;

fn main() -> ExitCode {
    eprintln!("tidemapd-planted-fault: this daemon loses acknowledged observations; it is for tests only");
    match std::env::var("TIDEMAP_PLANTED_FAULT") {
        Err(_) => tidemapd::run(Arc::new(LateDisk::default())),
        Ok(name) => match Fault::named(&name) {
            Some(fault) => tidemapd::run(Arc::new(FaultyDisk(fault))),
            None => {
                eprintln!("there is no fault {name:?}");
                ExitCode::from(2)
            }
        },
    }
}
