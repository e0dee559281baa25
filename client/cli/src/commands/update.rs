//! `tidemap update`.
//!
//! Invariant: the report is of the job that this command started.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::updates::JobState;
use tonic::Code;

use super::{Session, job, times};
use crate::progress::status_line;
use tidemap_formats::table::{Cell, Format};

#[derive(Debug, Args)]
pub(crate) struct UpdateArgs {
    /// Name of the map
    map: String,
    /// Learns only observations before this time [default: all]
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    until: Option<i64>,
}

const COLUMNS: [&str; 8] = ["state", "order_before", "order", "mse_before", "mse", "observations", "scored", "model"];

/// The meanings of the columns, for people.
const EXPLANATION: [&str; 3] = [
    "model: the model that predicts the state from now on; order: the number of rhythms of its spectral model",
    "scored: learned observations that the model of their day had predicted; mse: the mean squared error of this model on",
    "them, mse_before: of the spectral model with the order before; empty where nothing was scored",
];

pub(crate) async fn run(session: &Session, args: &UpdateArgs) -> anyhow::Result<ExitCode> {
    let client = &session.client;
    let started = client.run_update(&args.map, args.until).await?;
    let ended = job::watch(client, started.id).await?;
    if ended.state == JobState::Failed {
        anyhow::bail!(job::failure(&ended));
    }
    let mut table = session.table(&COLUMNS);
    let (mut token, mut states) = (Some(String::new()), 0_u64);
    while let Some(page_token) = token {
        let page = client.update_report(started.id, &page_token).await;
        if page.as_ref().is_err_and(|error| error.code() == Some(Code::NotFound)) {
            status_line(&format!(
                "the update is done, but another one followed immediately: `tidemap job list` shows job {}",
                started.id
            ));
            break;
        }
        let (updates, next) = page?;
        for update in updates {
            states += 1;
            table.row(vec![
                Cell::Text(update.state),
                update.order_before.into(),
                update.order.into(),
                Cell::maybe(update.mean_squared_error_before),
                Cell::maybe(update.mean_squared_error),
                update.observations.into(),
                update.scored.into(),
                Cell::maybe(update.model.map(|model| Cell::Text(model.to_string()))),
            ])?;
        }
        token = next;
    }
    table.finish()?;
    if states == 0 && ended.observations == 0 {
        status_line(&format!("map {:?} has no observations to learn", args.map));
    } else if session.format == Format::Table && states > 0 {
        EXPLANATION.iter().for_each(|line| status_line(line));
    }
    Ok(ExitCode::SUCCESS)
}
