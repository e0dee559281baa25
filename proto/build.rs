//! Generates the wire types from the .proto files with protox, so that no system protoc is needed, and writes the
//! descriptor set that gRPC reflection serves.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message as _;

const FILES: [&str; 13] = [
    "types",
    "map",
    "observation",
    "query",
    "exploration",
    "topology",
    "route",
    "search",
    "landmark",
    "task",
    "maintenance",
    "cluster",
    "peer",
];

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<String> = FILES.iter().map(|file| format!("tidemap/v1/{file}.proto")).collect();
    for path in &paths {
        println!("cargo::rerun-if-changed={path}");
    }
    let descriptors = protox::compile(&paths, ["."])?;
    let out = PathBuf::from(env::var("OUT_DIR")?).join("tidemap.v1.bin");
    fs::write(&out, descriptors.encode_to_vec())?;
    let mut config = prost_build::Config::new();
    // The codec finds the bounds of a message by its name.
    config.enable_type_names();
    tonic_prost_build::configure()
        .codec_path("crate::codec::BoundedCodec")
        .bytes(".tidemap.v1.ObservationColumns.bits")
        .server_mod_attribute(".", "#[cfg(feature = \"server\")]")
        .compile_fds_with_config(descriptors, config)?;
    Ok(())
}
