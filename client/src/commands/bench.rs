//! `tidemap bench` (in progress).
//!
//! Invariant: none yet.
use std::process::ExitCode;
use super::Session;
#[derive(Debug, clap::Subcommand)]
pub enum BenchCommand { Observe }
pub async fn run(_session: &Session, _command: &BenchCommand) -> anyhow::Result<ExitCode> { Ok(ExitCode::FAILURE) }
