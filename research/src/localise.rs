//! Localisation by landmarks that come and go (T-RO, section VII): which place does a picture show, if it is compared
//! with the landmarks that are expected at its time?
//!
//! A recording has pictures of some places, one a month. Each month is held out once: a map learns in the other months
//! which landmarks were visible, one state each, and predicts them at the time of the picture. Of each place the most
//! probable landmarks are matched to the features of the picture ([`tidemap_plan::localise`]). Baselines without a map:
//! how often a landmark was visible (order 0), a sine of one year (order 1, not limited to [0, 1] where landmarks are
//! ranked), the experience of the nearest month, and a kernel over the season.
//!
//! - `recording.rs`: the files; `visibility.rs`: the models; `score.rs`: figures; `report.rs`: tables.
//!
//! Invariant: no data of the month held out is known to the models that predict it, and figures do not depend on the
//! number of threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use tidemap_map::{landmark::DescriptorError, live_map::InconsistentEvent, update::SumsUnavailable};
use tidemap_plan::localise::{ExpectedLandmark, MatchRules, MixedDescriptors, SeenFeatures, localise, most_probable};

mod recording;
mod report;
mod score;
mod visibility;

#[cfg(test)]
mod tests;

pub use recording::{LandmarkRecording, LandmarkRecordingError};
pub use report::{summary, write};
pub use score::{FoundPlaces, LocaliseScores};
use visibility::Prediction;

/// Numbers of landmarks of each place that are compared.
pub const COUNTS: [usize; 6] = [5, 10, 20, 30, 50, 100];

/// Why landmarks cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum LocaliseError {
    /// An event does not fit the map.
    Map(#[from] InconsistentEvent),
    /// The map cannot be read.
    Sums(#[from] SumsUnavailable),
    /// Descriptors differ in length.
    Mixed(#[from] MixedDescriptors),
    /// A descriptor is too long.
    Descriptor(#[from] DescriptorError),
    /// The map is inconsistent.
    #[error("{0}")]
    Setting(String),
}

impl LocaliseError {
    fn setting(error: impl std::fmt::Display) -> Self {
        Self::Setting(error.to_string())
    }
}

/// A way to predict which landmarks are visible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisibilityModel {
    /// The share of months in which the landmark was visible.
    Mean,
    /// A sine of one year.
    Yearly,
    /// The landmarks of the month nearest in the year first.
    NearestMonth,
    /// The months weighted by their distance in the year.
    Season,
    /// The prediction of the map.
    Auto,
}

/// All models, in the order of the table.
pub const VISIBILITY_MODELS: [VisibilityModel; 5] = [
    VisibilityModel::Mean,
    VisibilityModel::Yearly,
    VisibilityModel::NearestMonth,
    VisibilityModel::Season,
    VisibilityModel::Auto,
];

impl VisibilityModel {
    /// The model of a name; `None`: there is none.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        VISIBILITY_MODELS.into_iter().find(|model| model.name() == name)
    }

    /// The name of the model in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Yearly => "yearly",
            Self::NearestMonth => "nearest-month",
            Self::Season => "season",
            Self::Auto => "auto",
        }
    }
}

/// The results, by model.
#[derive(Clone, Debug)]
pub struct LocaliseComparison {
    /// Number of pictures that were localised.
    pub pictures: usize,
    /// Figures of each model, in the order in which the models were requested.
    pub models: Vec<(VisibilityModel, LocaliseScores)>,
}

/// Compares models. `progress`: months done, and all.
///
/// # Errors
/// [`LocaliseError`]
pub fn run(
    recording: &LandmarkRecording,
    models: &[VisibilityModel],
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<LocaliseComparison, LocaliseError> {
    let (done, months) = (AtomicU64::new(0), recording.months());
    let of_month = |month: usize| {
        let found = held_out(recording, models, month);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, months as u64);
        found
    };
    let of_months: Vec<Vec<LocaliseScores>> = (0..months).into_par_iter().map(of_month).collect::<Result<_, _>>()?;
    let mut models: Vec<(VisibilityModel, LocaliseScores)> =
        models.iter().map(|&model| (model, LocaliseScores::default())).collect();
    for of_month in of_months {
        for ((_, all), scores) in models.iter_mut().zip(of_month) {
            all.add(scores);
        }
    }
    Ok(LocaliseComparison { pictures: months * recording.places(), models })
}

/// Figures of each model for the pictures of a month.
fn held_out(
    recording: &LandmarkRecording,
    models: &[VisibilityModel],
    month: usize,
) -> Result<Vec<LocaliseScores>, LocaliseError> {
    let (places, rules) = (recording.held_out(month), MatchRules::default());
    let of_model = |model: VisibilityModel| {
        let predicted = visibility::predict(model, recording, places, month)?;
        let mut scores = LocaliseScores::default();
        for place in 0..recording.places() {
            let picture = recording.picture(place, month);
            let seen = SeenFeatures::new(picture.to_vec())?;
            let again = recording.seen_again(places, place, month)?;
            scores.visible(&predicted[place], &again);
            for (at, count) in COUNTS.into_iter().enumerate() {
                let expected: Vec<Vec<ExpectedLandmark>> = places
                    .iter()
                    .zip(&predicted)
                    .map(|(landmarks, predicted)| {
                        let rank = |prediction: &Prediction| [prediction.rank, prediction.mean];
                        let numbers: Vec<[f64; 2]> = predicted.iter().map(rank).collect();
                        let landmark = |index: usize| ExpectedLandmark {
                            feature: landmarks[index].feature,
                            visible: predicted[index].probability,
                        };
                        most_probable(&numbers, count).into_iter().map(landmark).collect()
                    })
                    .collect();
                let found = localise(&seen, &expected, &rules)?;
                scores.picture(at, place, &found, recording.offset_px(place, month));
            }
        }
        Ok(scores)
    };
    models.iter().copied().map(of_model).collect()
}
