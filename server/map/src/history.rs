//! What one update folded in, exactly, for recall long after.
//!
//! A cell's readings are kept as the paper's outlier set (T-RO 2017, section III.B): where a small model of the day
//! tells when the cell is occupied, only the times at which it was wrong are kept, as differences.
//!
//! Invariant: what was observed is given back to the last bit, whatever model it was kept against.

use tidemap_model::Sample;

use crate::{
    grid::{day::GridDay, index::TileId},
    ids::StateId,
};

mod bits;
mod choose;
mod exchange;
mod phasors;
mod recall;
mod seen;
mod turn;

#[cfg(test)]
mod tests;

pub use recall::cell_readings;

/// What was observed: nanoseconds UTC, and value.
pub type Reading = (i64, f64);

/// Whose observations are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Subject {
    /// Those of a named state.
    State(StateId),
    /// Those of a cell: its tile, and its place there.
    Cell(TileId, u16),
}

/// The exact observations that one update folded in.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryPiece {
    /// The generation that the update published; pieces are told apart by it.
    pub generation: u64,
    /// Least time of the observations, nanoseconds UTC.
    pub from_nanos: i64,
    /// Greatest time of the observations, nanoseconds UTC.
    pub to_nanos: i64,
    /// Observations of named states, by state, in order of arrival.
    pub states: Vec<(StateId, Vec<Sample>)>,
    /// Scans of the grid by day.
    pub days: Vec<HistoryDay>,
}

/// The scans of one day, with occupied bits replaced by outliers for the cells that have a model.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryDay {
    /// The scans. The occupied bit of a modelled cell says at observed scans whether the model is wrong.
    pub outliers: GridDay,
    /// The cells that have a model: tile and models ascending.
    pub models: Vec<(TileId, Vec<OutlierModel>)>,
}

/// The small model against which a cell's outliers are kept: it says that the cell is occupied where mean + Σ 2|γ| cos(ωt
/// + arg γ) reaches 0.5, t being local civil time. Readings count as 0 and 1 here, whatever the sensor's noise.
#[derive(Clone, Debug, PartialEq)]
pub struct OutlierModel {
    /// Place of the cell in its tile.
    pub cell: u16,
    /// Mean.
    pub mean: f32,
    /// Components.
    pub components: Vec<OutlierComponent>,
}

/// One component of an outlier model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutlierComponent {
    /// Index of the periodicity.
    pub periodicity: u16,
    /// Real part of γ.
    pub gamma_re: f32,
    /// Imaginary part of γ.
    pub gamma_im: f32,
}

impl HistoryPiece {
    /// A piece without observations.
    #[must_use]
    pub fn new(generation: u64) -> HistoryPiece {
        HistoryPiece { generation, from_nanos: 0, to_nanos: 0, states: Vec::new(), days: Vec::new() }
    }

    /// Memory in bytes, about.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let states: usize = self.states.iter().map(|(_, samples)| size_of_val(samples.as_slice())).sum();
        states + self.days.iter().map(HistoryDay::bytes).sum::<usize>()
    }

    /// The piece with the times of its observations found out; `None` where it has none.
    #[must_use]
    pub(crate) fn bounded(mut self) -> Option<HistoryPiece> {
        let samples = self.states.iter().flat_map(|(_, samples)| samples).map(|sample| sample.utc_nanos);
        let scans = self.days.iter().flat_map(|day| &day.outliers.scans).map(|scan| scan.utc_nanos);
        let (mut from, mut to) = (i64::MAX, i64::MIN);
        for nanos in samples.chain(scans) {
            (from, to) = (from.min(nanos), to.max(nanos));
        }
        (self.from_nanos, self.to_nanos) = (from, to);
        (from <= to).then_some(self)
    }
}

impl HistoryDay {
    /// A day kept without models: its occupied bits are the readings.
    #[must_use]
    pub fn plain(day: GridDay) -> HistoryDay {
        HistoryDay { outliers: day, models: Vec::new() }
    }

    /// Memory in bytes, about.
    fn bytes(&self) -> usize {
        let models = self.models.iter().flat_map(|(_, models)| models);
        let models = models.map(|model| size_of::<OutlierModel>() + size_of_val(model.components.as_slice()));
        self.outliers.bytes() + models.sum::<usize>()
    }
}
