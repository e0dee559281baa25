//! The place of the recordings of real places: beside the repository and not in it. Tests of other crates include this
//! file.
//!
//! Invariant: tests that need a missing recording are skipped and print this. With `TIDEMAP_REQUIRE_DATA` set, they
//! fail.

use std::{env, path::PathBuf};

/// The folder of a recording. If it is missing, the result is `None` and a line is printed on stdout.
///
/// # Panics
/// Panics if the folder is missing and `TIDEMAP_REQUIRE_DATA` is set.
pub(crate) fn recordings(name: &str) -> Option<PathBuf> {
    let crate_folder = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let found = crate_folder.ancestors().map(|above| above.join("shared/data").join(name)).find(|path| path.is_dir());
    if found.is_none() {
        assert!(env::var_os("TIDEMAP_REQUIRE_DATA").is_none(), "there are no recordings {name:?} in ../shared/data");
        println!("SKIPPED: there are no recordings {name:?} in ../shared/data");
    }
    found
}
