//! The command line `tidemap`, and the parts that the program `tidemap-bench` shares with it.
//!
//! Invariant: results go to stdout, everything else to stderr. The exit status is 0 after success, 1 after a failure or
//! a refusal, 2 after a usage error and for a cluster that is lost, 130 after Ctrl-C.

mod commands;
mod counted;
mod daemon_child;
mod demo;

use std::process::ExitCode;

use commands::ClusterLost;
pub use commands::{
    connection::{ConnectionArgs, Session},
    files::read_text,
    job::{failure as job_failure, watch as watch_job},
    map::{enabled_models, grid_spec::retention as parse_retention, with_grid},
    office_scans::{OFFICE_RESOLUTION_M, OFFICE_ZONE, WireScans, record_office},
    times::duration as parse_duration,
    topology::from_file as topology_of_file,
};
use tidemap_formats::table::printable_json;
use tidemap_terminal::failure::{UsageError, is_broken_pipe};
/// Results and status lines.
pub(crate) use tidemap_terminal::{output, progress};

/// Runs the command line of this process.
#[must_use]
pub fn main() -> ExitCode {
    // Before any thread begins, because each takes over the priority of this one.
    if !daemon_child::follow_daemon() {
        return ExitCode::FAILURE;
    }
    let (command_line, subject) = match commands::parse() {
        Ok(parsed) => parsed,
        Err(error) => return not_parsed(&error),
    };
    let as_json = command_line.prints_json();
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return failed(&anyhow::Error::new(error).context("the runtime cannot start"), as_json),
    };
    let code = runtime.block_on(commands::run(command_line, &subject)).unwrap_or_else(|error| failed(&error, as_json));
    // A thread may still wait for stdin; do not wait for it.
    runtime.shutdown_background();
    code
}

/// Answers a command line that is wrong or requests help.
fn not_parsed(error: &clap::Error) -> ExitCode {
    let arguments: Vec<String> = std::env::args_os().map(|argument| argument.to_string_lossy().into_owned()).collect();
    if !error.use_stderr() || !commands::ask_for_json(&arguments) {
        error.exit();
    }
    let text = error.to_string();
    let message = text.split("\n\nUsage:").next().unwrap_or_default();
    let message = message.trim_start_matches("error: ").split_whitespace().collect::<Vec<_>>().join(" ");
    failed(&anyhow::Error::new(UsageError(message)), true)
}

/// Reports an error in one line, as JSON where results are JSON. A closed stdout is no error: its reader has stopped
/// reading on purpose.
pub fn failed(error: &anyhow::Error, as_json: bool) -> ExitCode {
    if is_broken_pipe(error) {
        return ExitCode::SUCCESS;
    }
    let is_usage = error.is::<UsageError>();
    let line = if as_json { json_of(error, is_usage) } else { format!("error: {error:#}") };
    progress::status_line(&line);
    if is_usage || error.is::<ClusterLost>() { ExitCode::from(2) } else { ExitCode::FAILURE }
}

/// `{"error":{"code":…,"message":…}}`: the code of the daemon's status, UNAVAILABLE if it cannot be reached,
/// UNAUTHENTICATED if it does not take the client's certificate, USAGE for a wrong command line, else FAILED.
fn json_of(error: &anyhow::Error, is_usage: bool) -> String {
    let code = match error.downcast_ref::<tidemap_client::Error>() {
        Some(tidemap_client::Error::Unreachable { .. }) => "UNAVAILABLE".to_owned(),
        Some(tidemap_client::Error::ClientCertificate { .. }) => "UNAUTHENTICATED".to_owned(),
        Some(error) => error.code().map_or("FAILED".to_owned(), |code| screaming(&format!("{code:?}"))),
        None if is_usage => "USAGE".to_owned(),
        None => "FAILED".to_owned(),
    };
    let error = serde_json::json!({ "error": { "code": code, "message": format!("{error:#}") } });
    printable_json(&error.to_string())
}

/// `NotFound` as `NOT_FOUND`.
fn screaming(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.push(letter.to_ascii_uppercase());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_as_json_has_its_code_and_message() {
        assert_eq!(["NotFound", "Unavailable"].map(screaming), ["NOT_FOUND", "UNAVAILABLE"]);
        let usage = anyhow::Error::new(UsageError("--ratio 2: \"too\" much".to_owned()));
        assert_eq!(json_of(&usage, true), r#"{"error":{"code":"USAGE","message":"--ratio 2: \"too\" much"}}"#);
        assert!(json_of(&anyhow::anyhow!("no file"), false).contains(r#""code":"FAILED""#));
        let strange = json_of(&anyhow::anyhow!("topic \u{202e}/a\u{9b}"), false);
        assert!(strange.contains(r#""message":"topic \u202e/a\u009b""#), "{strange}");
    }
}
