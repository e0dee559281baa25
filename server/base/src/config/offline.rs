//! The commands that the program runs instead of serving.
//!
//! Invariant: no command starts a daemon.

use std::path::PathBuf;

use crate::access::token_command::TokenCommand;

/// Command to run instead of serving.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum OfflineCommand {
    /// Print the content of the index of a data folder; no daemon may use the folder. The exit status is 0 if the index
    /// has a whole generation of every map, 1 if not, and 2 if it cannot be printed.
    Index {
        /// The data folder.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
        /// Print the rows of this map.
        #[arg(value_name = "MAP")]
        map: Option<String>,
    },
    /// Make, list and revoke tokens, in the file that is set by --tokens-file or the config file.
    Token {
        /// The command.
        #[command(subcommand)]
        command: TokenCommand,
    },
    /// Check every file of a data folder or a backup; no daemon may use it. The exit status is 0 if all is sound, 1 if
    /// not, and 2 if it cannot be checked.
    Check {
        /// The data folder.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
        /// Repair what can be repaired without loss: lists of files where the files prove to be all, and the index.
        #[arg(long)]
        repair: bool,
        /// Also continue without what is lost: lists that are lost, and files and maps that are listed and missing. The
        /// loss is recorded in the file LOSSES, which check, start and metrics show from then on.
        #[arg(long)]
        accept_loss: bool,
    },
    /// Check the engine of a cluster before daemons use it: print version and sync of its servers, and let writers race
    /// for the positions of a stream, which is made for that and deleted. The exit status is 0 if no position was taken
    /// twice and nothing was lost, 1 if not, and 78 if the engine cannot be used or reached, or the settings are wrong.
    CheckEngine {
        /// Duration of the race of the writers, in seconds, from 1 to 3600.
        #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
        seconds: u64,
    },
    /// Restore a backup, which `tidemap backup create` made.
    #[command(subcommand)]
    Backup(BackupCommand),
    /// Check the settings, and print those that the daemon would use, as a config file. The exit status is 78 if they
    /// are wrong.
    Config {
        /// Print a config file with the meaning and the default of every setting instead.
        #[arg(long)]
        example: bool,
    },
    /// Print the completions of a shell, for example: tidemapd completions bash.
    #[command(hide = true)]
    Completions {
        /// The shell.
        #[arg(value_name = "SHELL")]
        shell: clap_complete::Shell,
    },
    /// Write a man page for each command.
    #[command(hide = true)]
    ManPages {
        /// Folder for the pages.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
    },
}

/// Manage backups.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum BackupCommand {
    /// Check a backup and copy it to an empty folder, which a daemon can use then.
    Restore {
        /// The folder of the backup.
        #[arg(value_name = "BACKUP")]
        backup: PathBuf,
        /// The new data folder.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
    },
}
