//! Lists the files of the page, so that the daemon contains them.
//!
//! Without `client/web/dist` the daemon has no page; everything else is the same.

use std::{
    env,
    error::Error,
    fmt::Write as _,
    fs,
    hash::{DefaultHasher, Hash as _, Hasher as _},
    path::{Path, PathBuf},
};

fn list(folder: &Path, below: &str, files: &mut Vec<(String, PathBuf)>) -> Result<(), Box<dyn Error>> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().into_string().map_err(|name| format!("{name:?} is not UTF-8"))?;
        if entry.file_type()?.is_dir() {
            list(&entry.path(), &format!("{below}{name}/"), files)?;
        } else if let Some(plain) = name.strip_suffix(".gz") {
            files.push((format!("{below}{plain}"), entry.path()));
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../../client/web/dist");
    println!("cargo::rerun-if-changed={}", root.display());
    let mut files = Vec::new();
    if root.is_dir() {
        list(&root, "", &mut files)?;
    }
    files.sort();
    let mut code = String::from("const ASSETS: &[Asset] = &[\n");
    for (path, file) in files {
        let mut hasher = DefaultHasher::new();
        fs::read(&file)?.hash(&mut hasher);
        let (file, tag) = (file.canonicalize()?, format!("\"{:016x}\"", hasher.finish()));
        let file = file.display().to_string();
        writeln!(code, "    Asset {{ path: {path:?}, gzip: include_bytes!({file:?}), tag: {tag:?} }},")?;
    }
    code.push_str("];\n");
    fs::write(PathBuf::from(env::var("OUT_DIR")?).join("assets.rs"), code)?;
    Ok(())
}
