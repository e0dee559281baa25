//! The default forecaster on recordings of the field, by lead time, beside tables that anybody can make.
//!
//! Everything runs in one process, with the parts of a daemon: the readings of a recording become observations in a
//! [`LiveMap`](tidemap_map::live_map::LiveMap), one for each recording, which learns at each local midnight. The
//! readings of the last days are predicted at each [`Lead`]. A day, a week and four weeks ahead the view of an earlier
//! midnight predicts them. Five minutes and an hour ahead a view with the readings until then does, without an update
//! within the day. Each recording also runs with a random 5 % of its readings learned; the readings that are predicted
//! stay the same.
//!
//! - `recordings.rs`: the recordings and their files; `recording.rs`: one that was read, with what is asked;
//! - `lead.rs`: lead times; `replay.rs`: a recording night by night; `baselines.rs`: the tables;
//! - `score.rs`: squared error, loss, coverage; `report.rs`: results.csv, seconds.csv.
//!
//! Invariant: a prediction uses no reading that is later than its lead time allows, and the same folder gives the same
//! scores for any number of threads.

use std::{
    path::PathBuf,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable};

mod baselines;
mod lead;
mod recording;
mod recordings;
mod replay;
mod report;
mod score;

#[cfg(test)]
mod tests;

pub use baselines::BASELINES;
pub use lead::Lead;
pub use recordings::{FIELD_RECORDINGS, FieldRecording};
pub use report::{summary, write};
pub use score::{FIELD_MODELS, FieldErrors};

use crate::data::DataError;
use recording::{ReadRecording, UnitGroup};
use replay::{Spent, replay};
use score::Scorer;

/// The protocol of the experiment.
#[derive(Clone, Debug)]
pub struct FieldProtocol {
    /// The folder of data.
    pub folder: PathBuf,
    /// The recordings; all, if there is none.
    pub recordings: Vec<&'static FieldRecording>,
}

/// Why the experiment fails.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum FieldError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// A file is invalid.
    Data(#[from] DataError),
    /// A file is invalid, or no recording is there.
    #[error("{0}")]
    Setting(String),
}

impl FieldError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// The errors of one way to predict states of one unit at a lead time.
#[derive(Clone, Debug)]
pub struct FieldRow {
    /// The name of the recording.
    pub recording: &'static str,
    /// The states: the name of a single one, or how many of which.
    pub states: String,
    /// Whether a share of the readings was learned.
    pub is_thinned: bool,
    /// The lead time.
    pub lead: Lead,
    /// The way to predict, one of [`FIELD_MODELS`].
    pub model: &'static str,
    /// The errors of this way to predict.
    pub errors: FieldErrors,
    /// By how many percent its loss is above that of the best baseline; none if that loss is 0.
    pub above_best: Option<f64>,
}

/// The time that a recording took.
#[derive(Clone, Copy, Debug)]
pub struct FieldSeconds {
    /// The name of the recording.
    pub recording: &'static str,
    /// Whether a share of the readings was learned.
    pub is_thinned: bool,
    /// Seconds of learning.
    pub learning: f64,
    /// Seconds of asking.
    pub asking: f64,
}

/// The results of all recordings.
#[derive(Clone, Debug)]
pub struct FieldComparison {
    /// The rows: by recording, unit, full and thinned, lead time and way to predict. Lead times at which nothing was
    /// learned are left out.
    pub rows: Vec<FieldRow>,
    /// The time of each recording.
    pub seconds: Vec<FieldSeconds>,
    /// Why recordings were left out, a line each.
    pub left_out: Vec<String>,
}

/// Runs the recordings of a folder; `progress` receives the numbers of finished and of all runs.
///
/// # Errors
/// [`FieldError`] if a file is invalid, or if the folder has none of the recordings.
pub fn run(protocol: &FieldProtocol, progress: &(impl Fn(u64, u64) + Sync)) -> Result<FieldComparison, FieldError> {
    let is_wanted = |one: &&FieldRecording| {
        protocol.recordings.is_empty() || protocol.recordings.iter().any(|wanted| wanted.name == one.name)
    };
    let wanted: Vec<&FieldRecording> = FIELD_RECORDINGS.iter().filter(is_wanted).collect();
    let (mut found, mut left_out) = (Vec::new(), Vec::new());
    for read in wanted.par_iter().map(|recording| recording.read(&protocol.folder)).collect::<Vec<_>>() {
        match read? {
            Ok(recording) => found.push(recording),
            Err(why) => left_out.push(why),
        }
    }
    if found.is_empty() {
        let reasons: Vec<String> = left_out.iter().map(|why| format!("\n{why}")).collect();
        return Err(FieldError::Setting(format!("there is no recording to replay{}", reasons.concat())));
    }
    let mut jobs: Vec<(usize, bool)> = (0..found.len()).flat_map(|index| [(index, false), (index, true)]).collect();
    // The largest recordings come first, so that no thread is left with one of them at the end.
    jobs.sort_by_key(|&(index, is_thinned)| (is_thinned, std::cmp::Reverse(found[index].nights())));
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let mut runs = jobs
        .into_par_iter()
        .with_max_len(1)
        .map(|(index, is_thinned)| {
            let scored = scores_of(&found[index], is_thinned);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok(((index, is_thinned), scored?))
        })
        .collect::<Result<Vec<_>, FieldError>>()?;
    runs.sort_by_key(|(job, _)| *job);
    let mut outcome = FieldComparison { rows: Vec::new(), seconds: Vec::new(), left_out };
    for (_, (rows, seconds)) in runs {
        outcome.rows.extend(rows);
        outcome.seconds.push(seconds);
    }
    Ok(outcome)
}

/// Replays a recording and scores it.
fn scores_of(recording: &ReadRecording, is_thinned: bool) -> Result<(Vec<FieldRow>, FieldSeconds), FieldError> {
    let learned = recording.learned(is_thinned);
    let mut scorer = Scorer::new(recording, &learned);
    let Spent { learning, asking } = replay(recording, &learned, &mut |forecast| scorer.add(forecast))?;
    let (learning, asking) = (learning.as_secs_f64(), asking.as_secs_f64());
    let seconds = FieldSeconds { recording: recording.name, is_thinned, learning, asking };
    let of_group = |(group, by_lead): (&UnitGroup, [[FieldErrors; FIELD_MODELS.len()]; Lead::ALL.len()])| {
        let of_lead = |(lead, errors): (Lead, [FieldErrors; FIELD_MODELS.len()])| {
            let tables = &errors[FIELD_MODELS.len() - BASELINES.len()..];
            let best = tables.iter().map(FieldErrors::loss).fold(f64::INFINITY, f64::min);
            let row = |(model, errors): (&'static str, FieldErrors)| FieldRow {
                recording: recording.name,
                states: group.label.clone(),
                is_thinned,
                lead,
                model,
                errors,
                above_best: (best > 0.0).then(|| 100.0 * (errors.loss() / best - 1.0)),
            };
            let asked = FIELD_MODELS.into_iter().zip(errors).filter(|(_, errors)| errors.predictions > 0);
            asked.map(row).collect::<Vec<_>>()
        };
        Lead::ALL.into_iter().zip(by_lead).flat_map(of_lead).collect::<Vec<_>>()
    };
    Ok((recording.groups.iter().zip(scorer.errors()).flat_map(of_group).collect(), seconds))
}
