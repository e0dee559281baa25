//! Tells the version of the command line.
//!
//! Invariant: it is made as that of the daemon.

#[path = "../../server/build_version.rs"]
mod build_version;

fn main() {
    build_version::tell();
}
