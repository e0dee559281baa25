//! The command line of the daemon.
//!
//! Invariant: every option is also a key of the config file and an environment variable.

use std::path::PathBuf;

use clap::Parser;
use serde::Serialize;

use super::OfflineCommand;
use crate::{telemetry, telemetry::LogFormat};

/// tidemapd, the map service that learns when things change.
///
/// Every option is also a key of the config file and an environment variable: --data-dir, data_dir, TIDEMAP_DATA_DIR.
#[derive(Debug, Default, Parser, Serialize)]
#[command(name = "tidemapd", version = telemetry::VERSION)]
pub struct Flags {
    /// Command to run instead of serving.
    #[command(subcommand)]
    #[serde(skip)]
    pub command: Option<OfflineCommand>,
    /// Config file (TOML).
    #[arg(long, value_name = "FILE", env = "TIDEMAP_CONFIG", global = true)]
    #[serde(skip)]
    pub config: Option<PathBuf>,
    /// Folder of all data [default: ./tidemap-data].
    #[arg(long, value_name = "DIR")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_dir: Option<PathBuf>,
    /// Identity that the data folder must have; the daemon refuses another folder, and an empty one [default: none, any
    /// folder].
    #[arg(long, value_name = "ID")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expect_store_id: Option<String>,
    /// Address of the gRPC port; port 0 picks a free one [default: 127.0.0.1:7435].
    #[arg(long, value_name = "HOST:PORT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub listen: Option<String>,
    /// Address of the HTTP port: the page, JSON, health and metrics; port 0 picks a free one [default: 127.0.0.1:7436].
    #[arg(long, value_name = "HOST:PORT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub http_listen: Option<String>,
    /// File of the tokens that clients must have, as `tidemapd token` writes it [default: none, everybody may do
    /// everything].
    #[arg(long, value_name = "FILE", global = true)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tokens_file: Option<PathBuf>,
    /// Let everybody who reaches the HTTP port change data, where no tokens are configured. Without it, the HTTP port
    /// is for reading.
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub http_write: bool,
    /// Listen on other addresses than this machine's without TLS or without tokens: everybody who reaches the port can
    /// then read the transmitted data, or read, write and delete all maps.
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_insecure_remote: bool,
    /// Format of the log on stderr: text or json [default: text].
    #[arg(long, value_name = "FORM")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_format: Option<LogFormat>,
    /// Log filter: error, warn, info, debug, trace, or a filter such as tidemap=debug [default: info].
    #[arg(long, value_name = "FILTER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_level: Option<String>,
}
