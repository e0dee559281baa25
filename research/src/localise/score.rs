//! Figures of localisation.
//!
//! Invariant: figures of months added in any order are the same.

use tidemap_plan::localise::{NodeMatch, best_node};

use super::{COUNTS, visibility::Prediction};

/// A heading that is further off is wrong, pixels.
pub(super) const HEADING_WRONG_PX: f64 = 35.0;

/// The results with some landmarks of each place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundPlaces {
    /// Pictures whose place was found.
    pub found: usize,
    /// For the places that were found: the error of the heading, pixels.
    pub heading_errors_px: Vec<f64>,
    /// Pictures whose place has no heading, or a heading that is off by more than 35 px.
    pub heading_wrong: usize,
    /// Sum over the pictures of the negative logarithm of the probability of the true place, nats.
    pub log_loss: f64,
    /// Sum of the shares of the landmarks of the true place that are seen again.
    pub seen_again: f64,
}

/// Figures of a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocaliseScores {
    /// With each of [`COUNTS`] landmarks.
    pub places: [FoundPlaces; COUNTS.len()],
    /// Pictures.
    pub pictures: usize,
    /// Sum over the pictures of the mean squared errors of the landmarks of the true places.
    squared: f64,
}

impl LocaliseScores {
    /// Adds the figures of other pictures.
    pub(super) fn add(&mut self, other: LocaliseScores) {
        for (all, places) in self.places.iter_mut().zip(other.places) {
            all.found += places.found;
            all.heading_errors_px.extend(places.heading_errors_px);
            all.heading_errors_px.sort_by(f64::total_cmp);
            all.heading_wrong += places.heading_wrong;
            all.log_loss += places.log_loss;
            all.seen_again += places.seen_again;
        }
        self.pictures += other.pictures;
        self.squared += other.squared;
    }

    /// Scores the landmarks of the true place of a picture.
    pub(super) fn visible(&mut self, predicted: &[Prediction], again: &[bool]) {
        self.pictures += 1;
        let is_seen = |index: usize| f64::from(u8::from(again.get(index).copied().unwrap_or(false)));
        let squared = |(index, prediction): (usize, &Prediction)| (prediction.probability - is_seen(index)).powi(2);
        self.squared += predicted.iter().enumerate().map(squared).sum::<f64>() / predicted.len().max(1) as f64;
        let numbers: Vec<[f64; 2]> = predicted.iter().map(|prediction| [prediction.rank, prediction.mean]).collect();
        for (places, count) in self.places.iter_mut().zip(COUNTS) {
            let chosen = tidemap_plan::localise::most_probable(&numbers, count);
            places.seen_again += chosen.iter().map(|&index| is_seen(index)).sum::<f64>() / chosen.len().max(1) as f64;
        }
    }

    /// Scores the matches of a picture with the `at`-th of [`COUNTS`].
    pub(super) fn picture(&mut self, at: usize, place: usize, found: &[NodeMatch], offset_px: f64) {
        let Some(scores) = self.places.get_mut(at) else { return };
        let error_px = found[place].heading_px.map(|heading_px| (heading_px - offset_px).abs());
        scores.heading_wrong += usize::from(error_px.is_none_or(|error_px| error_px > HEADING_WRONG_PX));
        scores.log_loss -= found[place].probability.max(f64::MIN_POSITIVE).ln();
        if best_node(found) == Some(place) {
            scores.found += 1;
            scores.heading_errors_px.extend(error_px);
        }
    }

    /// Mean squared error of the landmarks of the true places (Brier score), each picture counting alike.
    #[must_use]
    pub fn mse(&self) -> f64 {
        self.squared / self.pictures.max(1) as f64
    }
}

impl FoundPlaces {
    /// Median of the heading errors of the places that were found, pixels.
    #[must_use]
    pub fn heading_px(&self) -> Option<f64> {
        let errors = &self.heading_errors_px;
        let middle = errors.len() / 2;
        let upper = *errors.get(middle)?;
        let even = errors.len().is_multiple_of(2);
        Some(if even { f64::midpoint(*errors.get(middle.wrapping_sub(1))?, upper) } else { upper })
    }
}
