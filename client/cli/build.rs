//! Sets the version of the command line.
//!
//! Invariant: the version is made in the same way as the daemon's.

#[path = "../../server/base/build_version.rs"]
mod build_version;

fn main() {
    build_version::set_version_variables();
}
