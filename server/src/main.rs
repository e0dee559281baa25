//! The program `tidemapd`: the daemon on the disk of this machine.

use std::{process::ExitCode, sync::Arc};

use tidemap_store::disk::RealDisk;
use tikv_jemallocator::Jemalloc;

/// Gives memory back after an update, which the allocator of the system keeps; `.cargo/config.toml` has its settings.
#[global_allocator]
static ALLOCATOR: Jemalloc = Jemalloc;

fn main() -> ExitCode {
    tidemapd::run(Arc::new(RealDisk))
}
