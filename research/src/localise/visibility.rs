//! The visibility of landmarks at a time: by a map, and by baselines.
//!
//! Invariant: only the months that were not held out are used.

use std::f64::consts::TAU;

use tidemap_map::{
    event::Observations,
    ids::StateId,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_model::{Periodicities, Sample, Zone, selector::ModelSelector};

use super::{
    LocaliseError, VisibilityModel,
    recording::{LandmarkRecording, RecordedLandmark},
};
use crate::nightly_map::NightlyMap;

const DAY_NANOS: i64 = 86_400_000_000_000;
const YEAR_NANOS: i64 = 365 * DAY_NANOS + DAY_NANOS / 4;
/// The rate at which the kernel over the season falls off.
const SEASON_SHARPNESS: f64 = 1.5;

/// The prediction for a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prediction {
    /// Probability that it is visible, in [0, 1].
    pub(super) probability: f64,
    /// Landmarks are ranked by this, the highest first.
    pub(super) rank: f64,
    /// The share of months in which it was visible, in [0, 1]; ranks landmarks with equal rank.
    pub(super) mean: f64,
}

/// The months that were not held out: their times, and whether a landmark was seen.
fn looks<'a>(
    recording: &'a LandmarkRecording,
    place: usize,
    landmark: &'a RecordedLandmark,
) -> impl Iterator<Item = (i64, bool)> + Clone + 'a {
    let of_month = move |(month, seen): (usize, &Option<bool>)| Some((recording.time_nanos(place, month), (*seen)?));
    landmark.seen.iter().enumerate().filter_map(of_month)
}

/// Turns of the year at a time.
fn phase(nanos: i64) -> f64 {
    TAU * (nanos.rem_euclid(YEAR_NANOS) as f64 / YEAR_NANOS as f64)
}

/// The prediction for each landmark of each place at the time of the picture of a month.
pub(super) fn predict(
    model: VisibilityModel,
    recording: &LandmarkRecording,
    places: &[Vec<RecordedLandmark>],
    month: usize,
) -> Result<Vec<Vec<Prediction>>, LocaliseError> {
    if model == VisibilityModel::Auto {
        return by_map(recording, places, month);
    }
    let of_landmark = |place: usize, landmark: &RecordedLandmark| {
        let at_nanos = recording.time_nanos(place, month);
        let looks = || looks(recording, place, landmark);
        let mean = looks().map(|(_, seen)| f64::from(u8::from(seen))).sum::<f64>() / looks().count() as f64;
        let rank = match model {
            VisibilityModel::Mean | VisibilityModel::Auto => mean,
            VisibilityModel::Yearly => yearly(looks(), mean, at_nanos),
            VisibilityModel::Season => season(looks(), at_nanos),
            VisibilityModel::NearestMonth => {
                // A month away in the year counts in both directions; the earlier of equals.
                let away = |nanos: i64| {
                    let turned = (nanos - at_nanos).rem_euclid(YEAR_NANOS);
                    turned.min(YEAR_NANOS - turned)
                };
                let nearest = looks().min_by_key(|(nanos, _)| away(*nanos));
                mean + f64::from(u8::from(nearest.is_some_and(|(_, seen)| seen)))
            }
        };
        let probability = if model == VisibilityModel::NearestMonth { rank - mean } else { rank };
        Prediction { probability: probability.clamp(0.0, 1.0), rank, mean }
    };
    let of_place = |(place, landmarks): (usize, &Vec<RecordedLandmark>)| {
        landmarks.iter().map(|landmark| of_landmark(place, landmark)).collect()
    };
    Ok(places.iter().enumerate().map(of_place).collect())
}

/// The mean and a sine of one year, not limited (T-RO, section III).
fn yearly(looks: impl Iterator<Item = (i64, bool)> + Clone, mean: f64, at_nanos: i64) -> f64 {
    let (mut re, mut im, mut count) = (0.0, 0.0, 0.0);
    for (nanos, seen) in looks {
        let difference = f64::from(u8::from(seen)) - mean;
        re += difference * phase(nanos).cos();
        im -= difference * phase(nanos).sin();
        count += 1.0;
    }
    // 2 |γ| cos(ω t + arg γ), with γ the mean of the differences turned back.
    mean + 2.0 * (re * phase(at_nanos).cos() - im * phase(at_nanos).sin()) / count
}

/// The months weighted by their distance in the year.
fn season(looks: impl Iterator<Item = (i64, bool)>, at_nanos: i64) -> f64 {
    let (mut weights, mut seen_weights) = (0.0, 0.0);
    for (nanos, seen) in looks {
        let weight = (SEASON_SHARPNESS * (phase(at_nanos) - phase(nanos)).cos()).exp();
        weights += weight;
        seen_weights += weight * f64::from(u8::from(seen));
    }
    seen_weights / weights
}

/// The predictions of a map that has learned the other months, each at the end of its day.
fn by_map(
    recording: &LandmarkRecording,
    places: &[Vec<RecordedLandmark>],
    month: usize,
) -> Result<Vec<Vec<Prediction>>, LocaliseError> {
    let mut map = map_of(recording, places)?;
    for learned in (0..recording.months()).filter(|&learned| learned != month) {
        let (mut observed, mut state) = (Observations::default(), 0);
        let mut newest_nanos = 0;
        for (place, landmarks) in places.iter().enumerate() {
            let utc_nanos = recording.time_nanos(place, learned);
            newest_nanos = newest_nanos.max(utc_nanos);
            for landmark in landmarks {
                let seen = landmark.seen.get(learned).copied().flatten().unwrap_or(false);
                let value = f64::from(u8::from(seen));
                observed.push(StateId(state), Sample { utc_nanos, offset_secs: 0, value });
                state += 1;
            }
        }
        map.observe(observed, state.into(), newest_nanos)?;
        let midnight_nanos = (newest_nanos.div_euclid(DAY_NANOS) + 1) * DAY_NANOS;
        map.update::<LocaliseError>(midnight_nanos)?;
    }
    let (view, mut state) = (map.view(), 0);
    let of_place = |(place, landmarks): (usize, &Vec<RecordedLandmark>)| {
        let times = view.prepare(&[recording.time_nanos(place, month)]);
        let of_landmark = |_: &RecordedLandmark| {
            let mut value = [0.0];
            view.predict_into(StateId(state), &times, ModelSelector::default(), &mut value);
            let mean = view.model(StateId(state)).accumulator().mean();
            state += 1;
            Prediction { probability: value[0].clamp(0.0, 1.0), rank: value[0], mean }
        };
        landmarks.iter().map(of_landmark).collect()
    };
    Ok(places.iter().enumerate().map(of_place).collect())
}

/// A map with a state for each landmark, which expects a rhythm of one year.
fn map_of(recording: &LandmarkRecording, places: &[Vec<RecordedLandmark>]) -> Result<NightlyMap, LocaliseError> {
    let name = MapName::new("landmarks").map_err(LocaliseError::setting)?;
    let periodicities = Periodicities::list(vec![YEAR_NANOS]).map_err(LocaliseError::setting)?;
    let created_nanos = recording.time_nanos(0, 0);
    let spec = MapSpec { zone: Zone::utc(), periodicities, created_nanos, ..MapSpec::new(name) };
    let producer = ProducerKey::new("robot", "").map_err(LocaliseError::setting)?;
    let mut map = NightlyMap::new(spec, producer);
    let numbers =
        places.iter().enumerate().flat_map(|(place, landmarks)| (0..landmarks.len()).map(move |at| (place, at)));
    for (place, at) in numbers {
        map.add_probability(StateName::new(&format!("landmark-{place}-{at}")).map_err(LocaliseError::setting)?)?;
    }
    Ok(map)
}
