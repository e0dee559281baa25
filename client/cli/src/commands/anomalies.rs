//! `tidemap anomalies`.
//!
//! Invariant: each row is an observation and the model's prediction for its time. With --watch, each row is written and
//! flushed as soon as it arrives, until the command is interrupted.

use std::process::ExitCode;

use anyhow::Context as _;
use clap::Args;
use tidemap_client::queries::{Anomaly, AnomalyWatch, Judgement, ModelSelector, WatchedPlaces};

use super::{
    Session,
    grid::place::{self, AxisRange, Rectangle},
    observe::INTERRUPTED,
    times, usage,
};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct AnomaliesArgs {
    /// Name of the map
    map: String,
    /// Name of the state, or cell/X/Y/Z; with --watch several names, or none for all named states
    #[arg(value_name = "STATE")]
    states: Vec<String>,
    /// How sure the model has to be of the opposite value, above 0.5 and at most 1. For other kinds of states: the
    /// confidence of the interval that a value has to lie outside of
    #[arg(long, value_name = "C", default_value_t = Judgement::default().confidence, value_parser = confidence)]
    confidence: f64,
    /// First time
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "to")]
    from: Option<i64>,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    to: Option<i64>,
    /// Model: those of predict except latest, persistence and those with a suffix; with --watch auto, mean or spectral
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Shows anomalies as they occur, until interrupted
    #[arg(long, conflicts_with_all = ["from", "to"])]
    watch: bool,
    /// Watches the cells of the grid in this rectangle, metres; at most 10,000 cells
    #[arg(long, value_name = "X0:X1,Y0:Y1", allow_hyphen_values = true, requires = "watch")]
    region: Option<Rectangle>,
    /// Only cells of the region between these heights, metres
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true, requires = "region")]
    z: Option<AxisRange>,
    /// Watches the states and cells of this location
    #[arg(long, value_name = "LOCATION", requires = "watch")]
    location: Option<String>,
}

fn confidence(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|&number: &f64| number > 0.5 && number <= 1.0);
    number.ok_or_else(|| "a confidence is above 0.5 and at most 1, for example 0.99".to_owned())
}

pub(crate) async fn run(session: &Session, args: AnomaliesArgs) -> anyhow::Result<ExitCode> {
    let AnomaliesArgs { map, states, confidence, from, to, model, watch, region, z, location } = args;
    let judgement = Judgement { confidence, model };
    if watch {
        let region = match region {
            Some(region) => Some(place::region_of(&session.client.map(&map).await?, Some(region), z)?),
            None => None,
        };
        let places = WatchedPlaces { states, region, location };
        let watch = session.client.watch_anomalies(&map, places, judgement).await?;
        return watched(session, watch).await;
    }
    let (Some(from), Some(to)) = (from, to) else {
        return Err(usage("give the times with --from and --to, or wait for anomalies with --watch"));
    };
    let [state] = states.as_slice() else {
        return Err(usage("name one state; several states need --watch"));
    };
    if from >= to {
        return Err(usage("--from must be before --to, which is not included"));
    }
    let mut anomalies = session.client.anomalies(&map, state, from, to, judgement).await?;
    let mut table = session.table(&["time", "value", "probability"]);
    while let Some(batch) = anomalies.next().await? {
        for Anomaly { utc_nanos: time_nanos, value, probability } in batch {
            table.row(vec![Cell::Time(time_nanos), value.into(), probability.into()])?;
        }
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}

async fn watched(session: &Session, mut watch: AnomalyWatch) -> anyhow::Result<ExitCode> {
    let mut table = session.table(&["time", "state", "value", "probability"]).live()?;
    let mut interrupted = std::pin::pin!(tokio::signal::ctrl_c());
    loop {
        let batch = tokio::select! {
            batch = watch.next() => batch,
            signal = &mut interrupted => {
                signal.context("signals")?;
                table.finish()?;
                return Ok(ExitCode::from(INTERRUPTED));
            }
        };
        let batch = match batch {
            Ok(Some(batch)) => batch,
            Ok(None) => {
                table.finish()?;
                anyhow::bail!("the daemon ended the watch");
            }
            Err(error) => {
                table.finish()?;
                return Err(error.into());
            }
        };
        if batch.missed > 0 {
            status_line(&format!(
                "{} observations were missed: they came faster than they could be read",
                batch.missed
            ));
        }
        for (state, Anomaly { utc_nanos: time_nanos, value, probability }) in batch.anomalies {
            table.row(vec![Cell::Time(time_nanos), Cell::Text(state), value.into(), probability.into()])?;
        }
    }
}
