//! Logs, metrics and traces of the process.
//!
//! Invariant: logs go to stderr; stdout contains only the line that names the ports.

use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use serde::{Deserialize, Serialize};

pub mod descriptions;
mod log_filter;
pub mod occasional;
pub mod process;
pub mod traces;

/// Upper ends of the classes of durations, in seconds: from a fast acknowledgement to a plan of minutes.
const BUCKETS_SECS: [f64; 16] =
    [0.000_5, 0.001, 0.002_5, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0];

/// Format of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object per line.
    Json,
}

/// Starts logging for the whole process.
///
/// # Errors
/// A filter that cannot be parsed.
pub fn start_logs(format: LogFormat, level: &str) -> anyhow::Result<()> {
    let filter = log_filter::parse(level)?;
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    match format {
        LogFormat::Text => builder.with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr())).init(),
        LogFormat::Json => builder.json().flatten_event(true).init(),
    }
    Ok(())
}

/// Checks a filter of the log.
///
/// # Errors
/// A filter that cannot be parsed, or that matches nothing of the daemon.
pub(crate) fn check_log_level(level: &str) -> anyhow::Result<()> {
    log_filter::parse(level).map(drop)
}

/// The version and, where it is known, the commit: the output of `--version`.
pub const VERSION: &str = env!("TIDEMAP_VERSION");

/// Reports the running program and its data, as a metric.
pub fn report_build(store_id: &str) {
    let (version, commit) = (env!("CARGO_PKG_VERSION"), env!("TIDEMAP_BUILT_FROM"));
    metrics::gauge!("tidemap_build_info", "version" => version, "commit" => commit, "store_id" => store_id.to_owned())
        .set(1.0);
}

/// Starts metrics for the whole process.
///
/// # Errors
/// Metrics were already started.
pub fn start_metrics() -> anyhow::Result<PrometheusHandle> {
    let seconds = Matcher::Suffix("_seconds".to_owned());
    let handle = PrometheusBuilder::new().set_buckets_for_metric(seconds, &BUCKETS_SECS)?.install_recorder()?;
    descriptions::describe();
    Ok(handle)
}
