//! Sums and counts of a tile that sensors with different levels have observed.
//!
//! With α and β of each reading (see [`crate::sensors`]) a cell of a group has x̄ = (Σα + Σ_occupied β)/n, and Σ x
//! e^(-jω_k t) = G_k + A_k, where G_k = Σ α e^(-jω_k t) over the group's readings and A_k = Σ β e^(-jω_k t) over the
//! cell's occupied readings. D_k = Σ β e^(-jω_k t) over the group's readings is equal to A_k of a cell that was always
//! occupied.
//!
//! With a half-life each reading counts in all of these sums, and in n, with its weight (see [`crate::fade`]).
//!
//! Invariant: where all readings are of the map's own sensor, and of the same weight, nothing is kept: G = 0, D = B,
//! Σα = 0, Σβ = n.

use std::sync::Arc;

use tidemap_model::PhasorSum;

use crate::{fade::GroupFade, observed_times::ObservedTimes, sensors::Weights};

/// The weights of the readings of a tile's cells, parallel to the groups and cells of its model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorWeights {
    /// Σα and Σβ over the readings of each group.
    pub groups: Vec<Weights>,
    /// Σβ over the occupied readings of each changed cell.
    pub occupied: Vec<f64>,
    /// The fading of each group; empty without a half-life.
    pub fades: Vec<GroupFade>,
}

impl SensorWeights {
    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.groups.len() * size_of::<Weights>()
            + self.occupied.len() * 8
            + self.fades.len() * size_of::<GroupFade>()
    }
}

/// Weighted sums over the readings of a group with readings of other sensors than the map's own.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightedSums {
    /// G_k = Σ α e^(-jω_k t).
    pub alpha: Arc<PhasorSum>,
    /// D_k = Σ β e^(-jω_k t).
    pub beta: Arc<PhasorSum>,
}

/// Weighted sums of a tile, parallel to the groups of its model; `None` where all readings of a group are of the map's
/// own sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorSums {
    /// The weighted sums of each group.
    pub groups: Vec<Option<WeightedSums>>,
}

impl SensorSums {
    /// The sums, which groups and tiles may share.
    pub fn sums(&self) -> impl Iterator<Item = &Arc<PhasorSum>> {
        self.groups.iter().flatten().flat_map(|weighted| [&weighted.alpha, &weighted.beta])
    }
}

/// The sums over the readings of a group.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GroupSums {
    /// The sum B_k.
    pub(crate) plain: Arc<PhasorSum>,
    pub(crate) weighted: Option<WeightedSums>,
    /// The times at which the group was observed; `None` for a part of its readings.
    pub(crate) times: Option<Arc<ObservedTimes>>,
}

impl GroupSums {
    /// The sum D_k.
    pub(crate) fn beta(&self) -> &Arc<PhasorSum> {
        self.weighted.as_ref().map_or(&self.plain, |weighted| &weighted.beta)
    }

    /// These sums with the weight of every reading multiplied by a factor.
    pub(crate) fn scaled(&self, factor: f64) -> GroupSums {
        if factor == 1.0 {
            return self.clone();
        }
        let scaled = |sum: &PhasorSum| {
            let mut sum = sum.clone();
            sum.scale(factor);
            Arc::new(sum)
        };
        let weighted = |sums: &WeightedSums| WeightedSums { alpha: scaled(&sums.alpha), beta: scaled(&sums.beta) };
        GroupSums {
            plain: scaled(&self.plain),
            weighted: self.weighted.as_ref().map(weighted),
            times: self.times.clone(),
        }
    }

    /// Sums over these readings and other readings; at most one of the two has times.
    pub(crate) fn plus(&self, other: &GroupSums) -> GroupSums {
        let sum = |one: &PhasorSum, other: &PhasorSum| {
            let mut sum = one.clone();
            sum.add(other);
            Arc::new(sum)
        };
        let weighted = (self.weighted.is_some() || other.weighted.is_some()).then(|| WeightedSums {
            alpha: match (&self.weighted, &other.weighted) {
                (Some(one), Some(other)) => sum(&one.alpha, &other.alpha),
                (Some(one), None) => Arc::clone(&one.alpha),
                // At least one of the two exists.
                (None, other) => Arc::clone(other.as_ref().map_or(&self.plain, |other| &other.alpha)),
            },
            beta: sum(self.beta(), other.beta()),
        });
        let times = self.times.as_ref().or(other.times.as_ref()).cloned();
        GroupSums { plain: sum(&self.plain, &other.plain), weighted, times }
    }

    /// The addresses of the sums. They identify equal sums while all of them are alive.
    pub(crate) fn addresses(&self) -> [usize; 3] {
        let address = |sum: &Arc<PhasorSum>| Arc::as_ptr(sum) as usize;
        let weighted = self.weighted.as_ref();
        [address(&self.plain), weighted.map_or(0, |w| address(&w.alpha)), weighted.map_or(0, |w| address(&w.beta))]
    }
}
