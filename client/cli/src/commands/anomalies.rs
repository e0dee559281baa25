//! `tidemap anomalies`.
//!
//! Without --model a row is a run of observations that were unusual before they were learned, the most surprising
//! first.
//!
//! Invariant: with --model, and with --watch, each row is an observation and the model's prediction for its time. With
//! --watch, each row is written and flushed as soon as it arrives, until the command is interrupted.

use std::{ops::Range, process::ExitCode};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::queries::{
    Anomaly, AnomalyWatch, Judgement, KEPT_CONFIDENCE, ModelSelector, SurpriseQuery, WatchedPlaces,
};

use super::{
    Session, UsageError,
    grid::place::{self, AxisRange, Rectangle},
    observe::INTERRUPTED,
    predict::names,
    times::{self, When},
    usage,
};
use crate::progress::status_line;
use tidemap_formats::table::Cell;
use tidemap_model::Zone;

#[derive(Debug, Args)]
pub(crate) struct AnomaliesArgs {
    /// Name of the map
    map: String,
    /// Names of states, or patterns such as 'door-*'; none for all named states; with --model one name, or cell/X/Y/Z
    #[arg(value_name = "STATE")]
    states: Vec<String>,
    /// Minimum confidence of the model in the opposite value, above 0.5 and at most 1; from 0.9 on without --model and
    /// --watch. For other kinds of states: the confidence of the interval that a value has to lie outside of
    #[arg(long, value_name = "C", default_value_t = Judgement::default().confidence, value_parser = number)]
    confidence: f64,
    /// First time [default: a week before the newest observation]
    #[arg(long, value_name = "TIME", value_parser = times::when, requires = "to")]
    from: Option<When>,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = times::when, requires = "from")]
    to: Option<When>,
    /// A whole day of the map's zone: today, tomorrow, yesterday or a date
    #[arg(long, value_name = "DAY", conflicts_with_all = ["from", "to", "watch"])]
    date: Option<String>,
    /// Reads times without a time zone in the map's zone
    #[arg(long)]
    local: bool,
    /// Judges every observation that the map keeps by this model as it is now, and not as it was before it learned
    /// them: those of predict except latest, persistence and those with a suffix; with --watch auto (the default), mean
    /// or spectral
    #[arg(long, value_name = "KIND")]
    model: Option<ModelSelector>,
    /// Maximum number of runs, without --model
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    #[arg(conflicts_with_all = ["model", "watch"])]
    top: u32,
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

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "a confidence is a number above 0.5 and at most 1, for example 0.99".to_owned())
}

/// Refuses a confidence that the query does not allow. `is_kept`: the query is for observations that were unusual
/// before they were learned.
fn check_confidence(confidence: f64, is_kept: bool) -> Result<(), UsageError> {
    if is_kept && !(KEPT_CONFIDENCE..=1.0).contains(&confidence) {
        return Err(UsageError(format!(
            "--confidence {confidence}: unusual observations are kept from a confidence of {KEPT_CONFIDENCE} on, so \
             use {KEPT_CONFIDENCE} to 1; with a model that judges the past, as in --model auto, it has to be above \
             0.5"
        )));
    }
    match confidence > 0.5 && confidence <= 1.0 {
        true => Ok(()),
        false => Err(UsageError(format!("--confidence {confidence}: it has to be above 0.5 and at most 1, as 0.99"))),
    }
}

pub(crate) async fn run(session: &Session, args: AnomaliesArgs) -> anyhow::Result<ExitCode> {
    let AnomaliesArgs { map, states, confidence, from, to, date, local, model, top, watch, region, z, location } = args;
    // Cells keep no unusual observations: the model in force judges the observations of one cell.
    let is_of_cell = matches!(&states[..], [name] if name.starts_with("cell/"));
    let is_kept = !watch && model.is_none() && !is_of_cell;
    check_confidence(confidence, is_kept)?;
    let judgement = Judgement { confidence, model: model.unwrap_or_default() };
    if watch {
        let region = match region {
            Some(region) => Some(place::region_of(&session.client.map(&map).await?, Some(region), z)?),
            None => None,
        };
        let places = WatchedPlaces { states, region, location };
        let watch = session.client.watch_anomalies(&map, places, judgement).await?;
        return watched(session, watch).await;
    }
    let zone = match local || date.is_some() {
        true => Some(Zone::named(&session.client.map(&map).await?.time_zone)?),
        false => None,
    };
    let (from, to) = match (from, to, &date, &zone) {
        (Some(from), Some(to), ..) => (from.resolve(zone.as_ref())?, to.resolve(zone.as_ref())?),
        (_, _, Some(date), Some(zone)) => times::day(date, zone)?,
        _ => last_week(session, &map).await?,
    };
    if from >= to {
        return Err(usage("--from must be before --to, which is not included"));
    }
    if is_kept {
        let states = if states.is_empty() { states } else { names::meant(session, &map, states).await? };
        let query = SurpriseQuery { states, from_nanos: from, to_nanos: to, confidence, top };
        return surprises(session, &map, query).await;
    }
    let [state] = states.as_slice() else {
        return Err(usage("name one state with --model; several states go without it, or with --watch"));
    };
    judge_past(session, &map, state, from..to, judgement).await
}

/// The week before the newest observation of a map.
async fn last_week(session: &Session, map: &str) -> anyhow::Result<(i64, i64)> {
    let mut newest: Option<i64> = None;
    let mut token = Some(String::new());
    while let Some(page_token) = token {
        let (states, next) = session.client.states(map, &page_token).await?;
        newest = newest.max(states.iter().filter_map(|state| state.last_nanos).max());
        token = next;
    }
    let newest = newest.ok_or_else(|| usage(format!("map {map:?} has no observations of states yet")))?;
    status_line(&format!("the week up to the newest observation, {}", session.times.heading(newest)));
    Ok((newest.saturating_sub(WEEK_NANOS).max(0), newest.saturating_add(1)))
}

const WEEK_NANOS: i64 = 7 * 86_400_000_000_000;

/// Prints the observations that were unusual before they were learned.
async fn surprises(session: &Session, map: &str, query: SurpriseQuery) -> anyhow::Result<ExitCode> {
    let found = session.client.surprises(map, query).await?;
    let mut table = session.table(&["state", "first", "last", "observations", "value", "probability", "surprise_bits"]);
    for (state, run) in found.runs {
        table.row(vec![
            Cell::Text(state),
            Cell::Time(run.first_nanos),
            Cell::Time(run.last_nanos),
            run.observations.into(),
            run.value.into(),
            run.probability.into(),
            run.bits.into(),
        ])?;
    }
    table.finish()?;
    if found.dropped > 0 {
        status_line(&format!("{} weaker or older runs of these states were dropped to make room", found.dropped));
    }
    Ok(ExitCode::SUCCESS)
}

/// Judges the observations of the past by a model as it is now.
async fn judge_past(
    session: &Session,
    map: &str,
    state: &str,
    within: Range<i64>,
    judgement: Judgement,
) -> anyhow::Result<ExitCode> {
    let mut anomalies = session.client.anomalies(map, state, within.start, within.end, judgement).await?;
    let mut next = anomalies.next_labelled().await?;
    while next.as_ref().is_some_and(|(found, _)| found.is_empty()) {
        next = anomalies.next_labelled().await?;
    }
    let has_labels = next.as_ref().is_some_and(|(_, labels)| !labels.is_empty());
    // Scripts rely on the three columns of other states.
    let columns = ["time", "value", "probability", "label"];
    let mut table = session.table(if has_labels { &columns } else { &columns[..3] });
    while let Some((batch, labels)) = next {
        let mut labels = labels.into_iter();
        for Anomaly { utc_nanos: time_nanos, value, probability } in batch {
            let label = has_labels.then(|| labels.next().map_or(Cell::Empty, Cell::Text));
            let cells = [Cell::Time(time_nanos), value.into(), probability.into()];
            table.row(cells.into_iter().chain(label).collect())?;
        }
        next = anomalies.next_labelled().await?;
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

#[test]
fn a_confidence_out_of_range_names_the_bound_of_its_question() {
    let error = |confidence, is_kept| check_confidence(confidence, is_kept).err().map(|error| error.0);
    for kept in [0.9, 0.99, 1.0] {
        assert_eq!((error(kept, true), error(kept, false)), (None, None));
    }
    assert_eq!(error(0.6, false), None);
    for wrong in [0.5, 0.6, 1.1, f64::NAN] {
        assert!(error(wrong, true).is_some_and(|text| text.contains("use 0.9 to 1")), "{wrong}");
    }
    for wrong in [0.5, 0.3, 1.1, f64::NAN] {
        assert!(error(wrong, false).is_some_and(|text| text.contains("above 0.5 and at most 1")), "{wrong}");
    }
}
