//! Recognises the activity of a person: a classifier that is often wrong, helped by the usual activities at the time
//! and place.
//!
//! The protocol is that of Krajník et al., "Frequency Map Enhancement", 2016, section VIII, on a recording with an
//! activity and a place for each minute. The classifier names activity k where r is true with probability C\[r\]\[k\].
//! Each minute has the posterior of `LabelEvidence`: C\[r\]\[k\] times the prediction of a temporal model of each
//! activity, times how usual the place is for the activity, where the place is known. The score of a minute is the
//! posterior of the true activity; minutes without a known activity are left out. At midnight the models learn the
//! activities recognised on the day, one activity drawn from each posterior, and never the truth.
//!
//! - `recording.rs`: the files; `classifier.rs`: the matrices; `model.rs`: the models by name;
//! - `priors.rs`: the usual activities at a time; `course.rs`: one run; `trend.rs`: whether errors fall;
//! - `report.rs`: results.csv, days.csv, activities.csv, hours.csv.
//!
//! Invariant: a day is predicted from the activities recognised on the days before it, and the same protocol gives the
//! same figures for any number of threads.

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;
use tidemap_map::{live_map::InconsistentEvent, update::SumsUnavailable};
use tidemap_model::{label_evidence::InvalidEvidence, models::CannotTrain};

mod classifier;
mod course;
mod model;
mod priors;
mod recording;
mod report;
mod trend;

#[cfg(test)]
mod tests;

pub use classifier::ActivityClassifier;
pub use course::{ActivityCourse, TrueActivity};
pub use model::{ACTIVITY_MODELS, ActivityModel, WrongActivityModel};
pub use recording::ActivityRecordingError;
pub use report::{summary, write};
pub use trend::DayTrend;

use crate::seed_mean::SeedMean;
use recording::ActivityRecording;

/// Midnight before the first day, which is a Thursday: 2010-11-04 UTC.
const START_NANOS: i64 = 14_917 * 86_400_000_000_000;
/// The days whose scores are averaged, counted from 0: the days before are a week of learning.
const SCORED_FROM: usize = 6;
/// The days whose errors have a trend, counted from 0: the first day has no model.
const TREND_FROM: usize = 1;

/// The time of a minute of a day in nanoseconds UTC; days are counted from 0.
fn minute_nanos(day: usize, minute: usize) -> i64 {
    START_NANOS + (day * crate::place_recording::DAY_MINUTES + minute) as i64 * 60_000_000_000
}

/// The protocol of the experiment.
#[derive(Clone, Debug)]
pub struct ActivityProtocol {
    /// The folder of the recording.
    pub folder: PathBuf,
    /// Number of runs with different draws, at least 1.
    pub seeds: u64,
    /// The first seed; the others follow.
    pub first_seed: u64,
    /// The classifiers.
    pub classifiers: Vec<ActivityClassifier>,
    /// The models.
    pub models: Vec<ActivityModel>,
    /// The first days of the recording; none for all.
    pub days: Option<usize>,
}

/// Why the experiment fails.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum ActivityError {
    /// The recording is invalid.
    Recording(#[from] ActivityRecordingError),
    /// A posterior cannot be computed.
    Evidence(#[from] InvalidEvidence),
    /// A model cannot be trained.
    Training(#[from] CannotTrain),
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// The protocol or the map is inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl ActivityError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// One of the compared settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActivitySetting {
    /// The classifier.
    pub classifier: ActivityClassifier,
    /// The temporal prior.
    pub model: ActivityModel,
    /// Whether the place is a second prior.
    pub knows_place: bool,
}

/// The results of a setting with all seeds.
#[derive(Clone, Debug)]
pub struct ActivityScores {
    /// The setting.
    pub setting: ActivitySetting,
    /// The runs, by seed.
    pub courses: Vec<ActivityCourse>,
    days: usize,
}

impl ActivityScores {
    /// The score of a day, counted from 0; none if no activity of the day is known.
    pub fn day(&self, day: usize) -> Option<SeedMean> {
        let of_seed = |course: &ActivityCourse| course.sum(day..day + 1, |_, _| true).score();
        let seeds: Option<Vec<f64>> = self.courses.iter().map(of_seed).collect();
        Some(SeedMean::of(&seeds?))
    }

    /// The mean score of the days from the seventh on; none if there are no such days.
    pub fn late(&self) -> Option<SeedMean> {
        let of_seed = |course: &ActivityCourse| {
            let days = (SCORED_FROM..self.days).filter_map(|day| course.sum(day..day + 1, |_, _| true).score());
            let days: Vec<f64> = days.collect();
            (!days.is_empty()).then(|| days.iter().sum::<f64>() / days.len() as f64)
        };
        let seeds: Option<Vec<f64>> = self.courses.iter().map(of_seed).collect();
        Some(SeedMean::of(&seeds?))
    }

    /// The trend of the error, from the second day on; none with fewer than three days.
    pub fn error_trend(&self) -> Option<DayTrend> {
        let error = |day: usize| self.day(day).map(|score| 1.0 - score.mean);
        DayTrend::new(&(TREND_FROM..self.days).filter_map(error).collect::<Vec<f64>>())
    }

    /// The scores of the days from the seventh on, of all seeds together, by activity and hour.
    fn late_sum(&self, is_wanted: impl Fn(usize, usize) -> bool) -> TrueActivity {
        let mut sum = TrueActivity::default();
        self.courses.iter().for_each(|course| sum.join(&course.sum(SCORED_FROM..self.days, &is_wanted)));
        sum
    }
}

/// The results of all settings.
#[derive(Clone, Debug)]
pub struct ActivityComparison {
    /// By classifier, then by model, then without and with the place.
    pub settings: Vec<ActivityScores>,
    /// The names of the activities.
    pub activities: Vec<String>,
    /// Number of days.
    pub days: usize,
}

/// Runs all settings; `progress` receives the numbers of finished and of all runs.
pub fn run(
    protocol: &ActivityProtocol,
    progress: &(impl Fn(u64, u64) + Sync),
) -> Result<ActivityComparison, ActivityError> {
    let recording = ActivityRecording::read(Path::new(&protocol.folder))?;
    let days = protocol.days.unwrap_or(recording.days());
    if days > recording.days() {
        return Err(ActivityError::setting(format!("the recording has {} days, and not {days}", recording.days())));
    }
    let with_place = |classifier: ActivityClassifier, model: ActivityModel| {
        [false, true].map(|knows_place| ActivitySetting { classifier, model, knows_place })
    };
    let of_classifier = |&classifier: &ActivityClassifier| {
        protocol.models.iter().flat_map(move |&model| with_place(classifier, model)).collect::<Vec<_>>()
    };
    let settings: Vec<ActivitySetting> = protocol.classifiers.iter().flat_map(of_classifier).collect();
    let seeds = || (0..protocol.seeds).map(|seed| protocol.first_seed.wrapping_add(seed));
    let jobs: Vec<(ActivitySetting, u64)> =
        settings.iter().flat_map(|&setting| seeds().map(move |seed| (setting, seed))).collect();
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let courses = jobs
        .into_par_iter()
        .with_max_len(1)
        .map(|(setting, seed)| {
            let course = course::run(&recording, setting, seed, days);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            course
        })
        .collect::<Result<Vec<ActivityCourse>, ActivityError>>()?;
    let per_setting = courses.chunks((protocol.seeds as usize).max(1));
    let settings = settings.into_iter().zip(per_setting);
    let settings = settings.map(|(setting, courses)| ActivityScores { setting, courses: courses.to_vec(), days });
    Ok(ActivityComparison { settings: settings.collect(), activities: recording.names, days })
}
