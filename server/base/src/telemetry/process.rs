//! Memory, descriptors and disk of the process, as the system reports them.
//!
//! Invariant: values that the system does not report are left out.

use std::{fs, path::Path};

use rustix::{
    fs::statvfs,
    param::page_size,
    process::{Resource, getrlimit},
};

/// Name and value of each metric.
pub fn metrics(data_dir: &Path) -> Vec<(&'static str, f64)> {
    let mut found = Vec::new();
    let memory = fs::read_to_string("/proc/self/statm").ok();
    let pages = memory.as_deref().and_then(|text| text.split(' ').nth(1)?.parse::<f64>().ok());
    found.extend(pages.map(|pages| ("process_resident_memory_bytes", pages * page_size() as f64)));
    let descriptors = fs::read_dir("/proc/self/fd").ok().map(|entries| entries.count() as f64);
    found.extend(descriptors.map(|count| ("process_open_fds", count)));
    let max_open = getrlimit(Resource::Nofile).current;
    found.extend(max_open.map(|max_open| ("process_max_fds", max_open as f64)));
    if let Ok(disk) = statvfs(data_dir) {
        let bytes = |blocks: u64| blocks as f64 * disk.f_frsize as f64;
        found.push(("tidemap_disk_free_bytes", bytes(disk.f_bavail)));
        found.push(("tidemap_disk_size_bytes", bytes(disk.f_blocks)));
    }
    found
}
