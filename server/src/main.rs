//! The program `tidemapd`: the daemon on the disk of this machine.

use std::{process::ExitCode, sync::Arc};

use tidemap_store::disk::RealDisk;

fn main() -> ExitCode {
    tidemapd::run(Arc::new(RealDisk))
}
