//! The program `tidemapd`: the daemon on the disk of this machine.

use std::{process::ExitCode, sync::Arc};

use tidemap_store::disk::RealDisk;

/// This allocator gives memory back after an update; the allocator of the system keeps it. `.cargo/config.toml` has its
/// settings.
#[cfg(feature = "jemalloc")]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> ExitCode {
    tidemapd::run(Arc::new(RealDisk))
}
