//! The paths of the programs under test: beside the test itself, built with the same profile.
//!
//! Invariant: only programs that `cargo build` has built are used, never those of the PATH.

use std::{
    env,
    path::{Path, PathBuf},
};

/// The folder of this profile's programs, for example `target/debug`.
///
/// # Panics
/// If the test does not lie where cargo puts tests.
#[must_use]
pub fn profile_folder() -> PathBuf {
    let own = env::current_exe().expect("the test knows its own path");
    let folder = own.parent().and_then(Path::parent).expect("the test lies in a folder of a profile's folder");
    folder.to_path_buf()
}

/// The daemon.
#[must_use]
pub fn tidemapd() -> PathBuf {
    built("tidemapd")
}

/// The command line.
#[must_use]
pub fn tidemap() -> PathBuf {
    built("tidemap")
}

/// The load generator.
#[must_use]
pub fn tidemap_bench() -> PathBuf {
    built("tidemap-bench")
}

/// The experiments.
#[must_use]
pub fn tidemap_research() -> PathBuf {
    built("tidemap-research")
}

fn built(name: &str) -> PathBuf {
    let path = profile_folder().join(name);
    assert!(
        path.is_file(),
        "{} is missing: run `make test`, or `cargo build --workspace --bins --tests` first",
        path.display()
    );
    path
}

/// The daemon with the planted fault "acknowledge before fdatasync": a program of its own, never installed.
#[must_use]
pub fn tidemapd_with_planted_fault() -> PathBuf {
    built("tidemapd-planted-fault")
}
