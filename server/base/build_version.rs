//! The version of a program with the commit that it was built from, for the build scripts of both programs.
//!
//! Invariant: a build without optimisation does not know its commit, so that no commit makes it old. The environment
//! variable TIDEMAP_COMMIT names the commit where there is no repository, as in a container.

use std::{env, path::Path, process::Command};

fn git(args: &[&str]) -> Option<String> {
    let output = Command::new("git").args(args).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// The commit that is checked out, in an optimised build.
fn checked_out() -> Option<String> {
    if env::var("PROFILE").ok()? != "release" {
        return None;
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    // The reflog grows with each commit, whichever branch it is on.
    for file in ["logs/HEAD", "HEAD"] {
        let path = git(&["rev-parse", "--git-path", file])?;
        if Path::new(&path).exists() {
            println!("cargo::rerun-if-changed={path}");
            break;
        }
    }
    Some(commit)
}

/// Gives the code `TIDEMAP_VERSION`, as `0.1.0 (0123456789ab)`, and `TIDEMAP_BUILT_FROM`, which is empty if the commit
/// is not known.
pub(crate) fn set_version_variables() {
    println!("cargo::rerun-if-env-changed=TIDEMAP_COMMIT");
    let is_word = |word: &String| !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_alphanumeric());
    let commit = env::var("TIDEMAP_COMMIT").ok().filter(is_word).or_else(checked_out).unwrap_or_default();
    let version = env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let shown = if commit.is_empty() { version } else { format!("{version} ({commit})") };
    println!("cargo::rustc-env=TIDEMAP_VERSION={shown}");
    println!("cargo::rustc-env=TIDEMAP_BUILT_FROM={commit}");
}
