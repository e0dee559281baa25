//! Files of others: point clouds, octomaps, map settings and topologies.
#![no_main]

use tidemap_formats::{nav2, octomap, pcd, ply, topology};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((first, bytes)) = bytes.split_first() else { return };
    match first % 7 {
        0 => drop(pcd::read(bytes)),
        1 => drop(pcd::read_pose(bytes)),
        2 => drop(ply::read(bytes)),
        3 => drop(octomap::read(bytes)),
        4 => {
            // Settings, a zero byte, and the picture.
            let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
            let (settings, image) = bytes.split_at(end);
            if let Ok(settings) = nav2::read_settings(settings) {
                let _ = nav2::read(&settings, image.get(1..).unwrap_or_default());
            }
        }
        5 => drop(std::str::from_utf8(bytes).map(topology::read_lines)),
        _ => drop(std::str::from_utf8(bytes).map(topology::read_yaml)),
    }
});
