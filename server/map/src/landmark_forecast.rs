//! Predicts when landmarks are visible, from the states of the landmarks of a place.
//!
//! Invariant: all data comes from one view. A landmark without observations has the prior of a probability.

use tidemap_model::{StateKind, selector::ModelSelector};

use crate::{
    landmark::{Landmark, LandmarksAtPlace},
    name::PlaceName,
    predict::PreparedTimes,
    sighting::{PartOfEdge, SightingError},
    topology::TopologyError,
    view::MapView,
};

/// A landmark at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedLandmark<'a> {
    /// The landmark.
    pub landmark: &'a Landmark,
    /// Probability that it is visible, in [0, 1].
    pub probability: f64,
    /// Share of the sightings learned by the last update in which the landmark was seen; the prior without any.
    pub mean: f64,
    /// Number of sightings of its place in which it was in view.
    pub sightings: u64,
    /// Number of these sightings that the last update has learned; `mean` is over them.
    pub learned: u64,
}

impl MapView {
    /// The landmarks of a place; `None` where none were added.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNode`], [`TopologyError::UnknownEdge`].
    pub fn landmarks_at(&self, place: &PlaceName) -> Result<Option<&LandmarksAtPlace>, TopologyError> {
        let at = self.site().topology().place(place)?;
        Ok(self.site().landmarks().at(at).map(AsRef::as_ref))
    }

    /// Predicts all landmarks of a part of a place at the first of the times, in the order in which they were added.
    ///
    /// # Errors
    /// [`SightingError`] for a place or part that does not exist.
    pub fn predict_landmarks(
        &self,
        place: &PlaceName,
        part: PartOfEdge,
        times: &PreparedTimes,
        selector: ModelSelector,
    ) -> Result<Vec<PredictedLandmark<'_>>, SightingError> {
        part.check(place)?;
        let known = self.landmarks_at(place).map_err(|error| SightingError::Landmark(error.into()))?;
        let known = known.map_or(&[][..], LandmarksAtPlace::landmarks);
        let mut state = place.landmark_prefix();
        let place_length = state.len();
        let predict = |landmark| {
            state.truncate(place_length);
            let name: &Landmark = landmark;
            state.push_str(name.name.as_str());
            self.predict_landmark(landmark, &state, times, selector)
        };
        Ok(known.iter().filter(|landmark| part.holds(landmark)).map(predict).collect())
    }

    fn predict_landmark<'a>(
        &self,
        landmark: &'a Landmark,
        state: &str,
        times: &PreparedTimes,
        selector: ModelSelector,
    ) -> PredictedLandmark<'a> {
        let Some(id) = self.find(state) else {
            let prior = StateKind::Probability.untrained();
            return PredictedLandmark { landmark, probability: prior, mean: prior, sightings: 0, learned: 0 };
        };
        let mut probability = vec![f64::NAN; times.len()];
        self.predict_into(id, times, selector, &mut probability);
        let probability = probability.first().copied().unwrap_or(f64::NAN);
        let (mean, learned) = (self.model(id).spectral().mean(), self.model(id).learned_observations());
        PredictedLandmark { landmark, probability, mean, sightings: self.live(id).observations, learned }
    }
}
