//! Sets the version of the daemon, with the commit that it was built from.

mod build_version;

fn main() {
    build_version::set_version_variables();
}
