//! Where the programs under test are: beside the test itself, built with the same profile.
//!
//! Invariant: only what `cargo build` has put there is used, never a program of the PATH.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
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

fn built(name: &str) -> PathBuf {
    let path = profile_folder().join(name);
    assert!(
        path.is_file(),
        "{} is missing: run `make test`, or `cargo build --workspace --bins` first",
        path.display()
    );
    path
}

/// The daemon with the planted fault "acknowledge before fdatasync", built now unless it is there, into a folder of its
/// own, so that it never lies where the real one is looked for.
///
/// # Panics
/// If it cannot be built.
#[must_use]
pub fn tidemapd_with_planted_fault() -> PathBuf {
    let profile = profile_folder();
    let target = profile.parent().expect("a profile's folder lies in the target folder").join("planted-fault");
    let name = profile.file_name().and_then(|name| name.to_str()).expect("the folder has the profile's name");
    // cargo calls the profile `dev` and its folder `debug`; all other folders are called as their profiles.
    let profile_name = if name == "debug" { "dev" } else { name };
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command.args(["build", "--locked", "--package", "tidemapd", "--features", "fault-ack-before-sync", "--profile"]);
    command.arg(profile_name).arg("--target-dir").arg(&target);
    let output = command.output().expect("cargo can be started");
    assert!(
        output.status.success(),
        "the daemon with the planted fault cannot be built:\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    target.join(name).join("tidemapd")
}
