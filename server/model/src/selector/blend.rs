//! How a prediction is drawn towards the newest reading.
//!
//! Invariant: a drawn probability lies between the prediction and the newest value.

use crate::{MemoryBasis, Persistence};

/// How a prediction is drawn towards the newest reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Blend {
    /// Not at all.
    #[default]
    None,
    /// By the mean time between changes (T-RO eq. 12 and 13), which assumes that a state did not change between two
    /// equal readings.
    Persistence,
    /// By the rates of a two-state chain, which allow for changes that nobody saw (RAS 2017, eq. 6).
    Memory,
    /// By what the newest readings say, as far as they have proved right that far ahead: see
    /// [`Belief`](crate::Belief). What has no belief, such as a cell, has [`Blend::Persistence`] in its place.
    Belief,
}

impl Blend {
    /// All that change predictions, in the order of the documentation.
    pub const ALL: [Blend; 3] = [Blend::Belief, Blend::Persistence, Blend::Memory];

    /// Its name, as after the `+` of a model; empty for [`Blend::None`].
    pub fn name(self) -> &'static str {
        match self {
            Blend::None => "",
            Blend::Persistence => "persistence",
            Blend::Memory => "memory",
            Blend::Belief => "belief",
        }
    }

    /// What follows the name of a model: `+` and its name, or nothing.
    pub fn suffix(self) -> &'static str {
        match self {
            Blend::None => "",
            Blend::Persistence => "+persistence",
            Blend::Memory => "+memory",
            Blend::Belief => "+belief",
        }
    }

    /// The one of this name.
    pub fn named(name: &str) -> Option<Blend> {
        Blend::ALL.into_iter().find(|blend| blend.name() == name)
    }

    /// A prediction `p` for a time, drawn towards the newest reading of a state or cell that has no belief.
    #[must_use]
    pub fn draw(self, newest: &Persistence, basis: MemoryBasis, p: f64, utc_nanos: i64) -> f64 {
        match self {
            Blend::None => p,
            Blend::Persistence | Blend::Belief => newest.blend_of(basis.usual_change, p, utc_nanos),
            Blend::Memory => newest.remember(basis, p, utc_nanos),
        }
    }
}
