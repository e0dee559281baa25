//! `tidemapd`, the map service that learns when states change. The library has one entry point, [`run`], so that a test
//! can start the same daemon on another disk; the program is `main.rs`.
//!
//! Invariant: every end of the daemon has its exit status: 0 stopped as requested, 2 wrong usage, 65 the data cannot be
//! used, 69 a port is taken, 73 another daemon has the data, 74 storage failed, 78 wrong settings, 70 any other error.

mod cluster_figures;
mod command_texts;
mod daemon;
mod engine_check;
mod http;
mod index_print;
mod reload;
mod repair;
mod scrubber;
mod silent_producers;
mod storage_watch;

use std::{process::ExitCode, sync::Arc};

use clap::Parser as _;
use tidemap_base::{
    access,
    config::{self, BackupCommand, Flags, OfflineCommand, Settings},
    telemetry,
};
use tidemap_store::disk::Disk;

/// Runs the whole daemon: reads the command line and the settings, serves until it is stopped, and returns the exit
/// status. All data that must survive a power cut goes through `disk`.
pub fn run(disk: Arc<dyn Disk>) -> ExitCode {
    let flags = Flags::parse();
    if let Some(code) = command_texts::run(&flags) {
        return code;
    }
    if let Some(OfflineCommand::Index { dir, map }) = &flags.command {
        return index_print::run(dir, map.as_deref());
    }
    match &flags.command {
        Some(OfflineCommand::Check { dir, repair, accept_loss }) => {
            return repair::run_check(dir, *repair, *accept_loss);
        }
        Some(OfflineCommand::Backup(BackupCommand::Restore { backup, dir })) => {
            return repair::run_restore(backup, dir);
        }
        _ => {}
    }
    let settings = match Settings::load(&flags).and_then(|settings| {
        // A check reports only the engine itself, not each connection.
        let is_check = matches!(flags.command, Some(OfflineCommand::CheckEngine { .. }));
        telemetry::start_logs(settings.log_format, if is_check { "warn" } else { &settings.log_level })?;
        config::instructions::apply(&settings.instruction_set)?;
        Ok(settings)
    }) {
        Ok(settings) => settings,
        Err(error) => {
            eprintln!("tidemapd: {error:#}");
            return ExitCode::from(78);
        }
    };
    let names = std::env::vars_os().filter_map(|(name, _)| name.into_string().ok());
    for warning in config::unknown::variables(names) {
        tracing::warn!("{warning}");
    }
    if let Some(OfflineCommand::Token { command }) = &flags.command {
        return access::token_command::run(command, &settings.tokens_file).unwrap_or_else(|error| {
            eprintln!("tidemapd: {error:#}");
            ExitCode::FAILURE
        });
    }
    if let Some(OfflineCommand::CheckEngine { seconds }) = flags.command {
        return engine_check::run(&settings, seconds);
    }
    if let Some(missing) = settings.missing_protection().filter(|_| settings.allow_insecure_remote) {
        tracing::warn!("the ports are open beyond this machine without {missing}: {}", missing.consequence());
    }
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("tidemapd: cannot start: {error}");
            return ExitCode::from(70);
        }
    };
    let result = runtime.block_on(daemon::run(settings, disk));
    // The daemon does not wait for a running update: the next start repeats it from the log.
    runtime.shutdown_background();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tidemapd: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}
