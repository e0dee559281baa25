//! Tokens for tests, made as an operator makes them.
//!
//! Invariant: tokens are made and revoked by `tidemapd token` only.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use crate::binaries;

/// A file of tokens.
#[derive(Clone, Debug)]
pub struct Tokens {
    /// Path of the file.
    pub path: PathBuf,
}

impl Tokens {
    /// A file of this folder that does not exist yet.
    #[must_use]
    pub fn of(folder: &Path) -> Self {
        Self { path: folder.join("tokens.toml") }
    }

    /// Runs `tidemapd token` with these arguments.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn run(&self, args: &[&str]) -> Output {
        let mut command = Command::new(binaries::tidemapd());
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
            command.env_remove(name);
        }
        command.arg("token").args(args).arg("--tokens-file").arg(&self.path).output().expect("tidemapd runs")
    }

    /// A new token of these roles for these maps; none are all.
    ///
    /// # Panics
    /// If it cannot be made.
    #[must_use]
    pub fn create(&self, roles: &[&str], maps: &[&str]) -> String {
        let mut args = vec!["create"];
        args.extend(roles.iter().flat_map(|role| ["--role", role]));
        args.extend(maps.iter().flat_map(|map| ["--map", map]));
        let made = self.run(&args);
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        String::from_utf8(made.stdout).expect("text").trim().to_owned()
    }

    /// Revokes a token.
    ///
    /// # Panics
    /// If there is no such token.
    pub fn revoke(&self, token: &str) {
        let id = token.split('_').nth(1).expect("an id");
        let revoked = self.run(&["revoke", id]);
        assert!(revoked.status.success(), "{}", String::from_utf8_lossy(&revoked.stderr));
    }
}
