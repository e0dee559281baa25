//! Learns where the labels of a categorical state hold: the spatial prior of a classification.
//!
//! The labels at a place are learned in a categorical state of their own, called `STATE@PLACE`, which has the labels of
//! the state. So they are as durable as any observation, fade with the half-life of the map, and are erased in the same
//! way. The number of observations of each label at a place is the sum that its state has learned.
//!
//! Invariant: only states with the same labels in the same order count.

use tidemap_model::label_evidence::LabelPlaces;

use crate::{
    name::{InvalidName, StateName},
    view::MapView,
};

/// The name of the state that learns the labels of a state at a place.
///
/// # Errors
/// [`InvalidName`], with what is wrong.
pub fn name_at_place(state: &StateName, place: &str) -> Result<StateName, InvalidName> {
    StateName::new(place)?;
    StateName::new(&format!("{state}@{place}"))
}

impl MapView {
    /// For each label of a categorical state, the probability of being at a place while the label holds, from the
    /// learned data at all places of the state. `None`: nothing was learned at this place.
    pub fn label_prior_at(&self, state: &StateName, place: &str) -> Option<Vec<f64>> {
        let labels = self.labels(state.as_str());
        let names: Vec<&str> = labels.iter().map(|(_, label)| *label).collect();
        let prefix = format!("{state}@");
        let is_alike = |known: &&StateName| {
            known.as_str().starts_with(&prefix)
                && self.labels(known.as_str()).iter().map(|(_, label)| *label).eq(names.iter().copied())
        };
        let mut places: Vec<&StateName> = self.categorical_states().filter(is_alike).collect();
        places.sort_unstable();
        let wanted = places.iter().position(|known| known.as_str().strip_prefix(&prefix) == Some(place))?;
        let mut counts = LabelPlaces::new(names.len(), places.len()).ok()?;
        for (at, known) in places.iter().enumerate() {
            for (label, (id, _)) in self.labels(known.as_str()).into_iter().enumerate() {
                let sums = self.model(id).accumulator();
                let count = if sums.observations() == 0 { 0.0 } else { sums.mean() * sums.weight() };
                counts.add_many(label, at, count).ok()?;
            }
        }
        counts.prior(wanted)
    }
}
