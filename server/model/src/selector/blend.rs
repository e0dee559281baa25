//! The published ways to draw a prediction towards the newest reading.
//!
//! The default model takes the newest readings into account by itself; these are asked for by name. Invariant: a drawn
//! probability lies between the prediction and the newest value.

use crate::{MemoryBasis, Persistence};

/// How a prediction is drawn towards the newest reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Blend {
    /// The prediction stays as it is.
    #[default]
    None,
    /// Draws by the mean time between changes (T-RO eq. 12 and 13), which assumes that a state did not change between
    /// two equal readings.
    Persistence,
    /// Draws by the rates of a two-state chain, which allow for unobserved changes (RAS 2017, eq. 6).
    Memory,
}

impl Blend {
    /// All blends that change predictions, in the order of the documentation.
    pub const ALL: [Blend; 2] = [Blend::Persistence, Blend::Memory];

    /// The name after the `+` of a model; empty for [`Blend::None`].
    pub fn name(self) -> &'static str {
        match self {
            Blend::None => "",
            Blend::Persistence => "persistence",
            Blend::Memory => "memory",
        }
    }

    /// The suffix of a model's name: `+` and the name of the blend, or nothing.
    pub fn suffix(self) -> &'static str {
        match self {
            Blend::None => "",
            Blend::Persistence => "+persistence",
            Blend::Memory => "+memory",
        }
    }

    /// The blend of this name.
    pub fn named(name: &str) -> Option<Blend> {
        Blend::ALL.into_iter().find(|blend| blend.name() == name)
    }

    /// A prediction `p` for a time, drawn towards the newest reading of a state or cell.
    #[must_use]
    pub fn draw(self, newest: &Persistence, basis: MemoryBasis, p: f64, utc_nanos: i64) -> f64 {
        match self {
            Blend::None => p,
            Blend::Persistence => newest.blend_of(basis.usual_change, p, utc_nanos),
            Blend::Memory => newest.remember(basis, p, utc_nanos),
        }
    }
}
