//! The default producer of this user and machine.
//!
//! Invariant: the name is generated once and kept; two commands that generate it at the same time get the same name.

use std::{
    env, fs,
    hash::{BuildHasher as _, Hasher as _, RandomState},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use anyhow::Context as _;

/// The producer of this user, from the configuration folder.
pub(crate) fn of_user() -> anyhow::Result<String> {
    let folder = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let config = folder("XDG_CONFIG_HOME").or_else(|| folder("HOME").map(|home| home.join(".config")));
    let config = config.context("neither XDG_CONFIG_HOME nor HOME is set: name the producer with --producer")?;
    let path = config.join("tidemap").join("producer");
    kept(&path).with_context(|| format!("{}; name the producer with --producer", path.display()))
}

fn kept(path: &Path) -> anyhow::Result<String> {
    if let Some(id) = read(path)? {
        return Ok(id);
    }
    let folder = path.parent().context("no folder")?;
    fs::create_dir_all(folder)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    writeln!(file, "{}", fresh())?;
    file.as_file().sync_all()?;
    match file.persist_noclobber(path) {
        Ok(_) => {}
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(error.error.into()),
    }
    read(path)?.context("it disappeared")
}

fn read(path: &Path) -> anyhow::Result<Option<String>> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let id = text.trim();
    anyhow::ensure!(!id.is_empty() && id.lines().count() == 1, "it does not hold one name on one line");
    Ok(Some(id.to_owned()))
}

/// The host's name, for people, and random digits, because machines are cloned.
fn fresh() -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String =
        host.trim().chars().filter(|c| c.is_ascii_alphanumeric() || "-_.".contains(*c)).take(40).collect();
    // The keys of a new hasher come from the operating system's random numbers.
    let random = RandomState::new().build_hasher().finish();
    format!("{}-{random:016x}", if host.is_empty() { "host" } else { &host })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_generated_once_and_kept() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("deep").join("producer");
        let first = kept(&path)?;
        assert!(first.len() > 16 && !first.contains(char::is_whitespace), "{first}");
        assert_eq!(kept(&path)?, first);
        fs::write(&path, "robot-1\n")?;
        assert_eq!(kept(&path)?, "robot-1");
        fs::write(&path, "\n")?;
        assert!(kept(&path).is_err());
        Ok(())
    }
}
