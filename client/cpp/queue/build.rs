//! Writes the bridge to C++ and compiles it into the library.

fn main() {
    cxx_build::bridge("src/lib.rs").std("c++17").compile("tidemap_cpp_bridge");
    println!("cargo:rerun-if-changed=src/lib.rs");
}
