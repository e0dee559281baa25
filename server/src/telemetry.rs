//! Logs and metrics of the process.
//!
//! Invariant: logs go to stderr; stdout is for the line that names the ports.

use anyhow::Context as _;
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};
use tracing_subscriber::EnvFilter;

use crate::config::LogFormat;

/// Starts logging for the whole process.
///
/// # Errors
/// A filter that cannot be parsed.
pub(crate) fn start_logs(format: LogFormat, level: &str) -> anyhow::Result<()> {
    let filter = EnvFilter::try_new(level).with_context(|| format!("setting log_level is {level:?}"))?;
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    match format {
        LogFormat::Text => builder.with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr())).init(),
        LogFormat::Json => builder.json().flatten_event(true).init(),
    }
    Ok(())
}

/// Starts metrics for the whole process.
///
/// # Errors
/// Metrics were started before.
pub(crate) fn start_metrics() -> anyhow::Result<PrometheusHandle> {
    let handle = PrometheusBuilder::new().install_recorder()?;
    metrics::describe_counter!("tidemap_observations_total", "Observations acknowledged since the start");
    metrics::describe_counter!("tidemap_refused_total", "Observations refused since the start");
    metrics::describe_counter!("tidemap_updates_total", "Updates published since the start");
    metrics::describe_gauge!("tidemap_streams", "Open streams of observations");
    Ok(handle)
}
