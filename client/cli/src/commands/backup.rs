//! `tidemap backup`.
//!
//! Invariant: the folder is a folder of the daemon's machine, whatever machine this is.

use std::process::ExitCode;

use clap::Subcommand;

use super::Session;

#[derive(Debug, Subcommand)]
pub(crate) enum BackupCommand {
    /// Copies all maps to a folder on the daemon's machine
    ///
    /// The folder is empty, or holds an earlier backup of the same daemon, which is brought up to date: only new files
    /// are copied. To restore it, stop the daemon and run tidemapd backup restore.
    Create {
        /// Path of the folder on the daemon's machine: below the daemon's folder of backups (setting backup_dir),
        /// relative to it or absolute; without that setting, any absolute path
        path: String,
    },
}

pub(crate) async fn run(session: &Session, command: &BackupCommand) -> anyhow::Result<ExitCode> {
    let BackupCommand::Create { path } = command;
    let made = session.client.create_backup(path).await?;
    let row = vec![made.maps.into(), made.copied_files.into(), made.copied_bytes.into(), made.kept_files.into()];
    session.print(&["maps", "copied_files", "copied_bytes", "kept_files"], [row])
}
