//! The exact observations that one update learned, kept for later reading.
//!
//! A cell's readings are kept as the outlier set of the paper (T-RO 2017, section III.B): where a small model of the
//! day predicts when the cell is occupied, only the times of wrong predictions are kept, as differences.
//!
//! Invariant: readings are recovered to the last bit, whatever model they were kept against.

use tidemap_grid::{day::GridDay, index::TileId};
use tidemap_model::Sample;

use self::origins::Origins;

use crate::ids::StateId;

mod bits;
mod choose;
mod exchange;
pub mod origins;
mod phasors;
mod recall;
mod seen;
mod turn;

#[cfg(test)]
mod tests;

pub use recall::cell_readings;
pub(crate) use recall::day_readings;

/// A reading: time in nanoseconds UTC, and value.
pub type Reading = (i64, f64);

/// A source of readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Subject {
    /// A named state.
    State(StateId),
    /// A cell: its tile, and its place in the tile.
    Cell(TileId, u16),
}

/// The exact observations that one update learned.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryPiece {
    /// The generation that the update published; it identifies the piece.
    pub generation: u64,
    /// Earliest time of the observations, nanoseconds UTC.
    pub from_nanos: i64,
    /// Latest time of the observations, nanoseconds UTC.
    pub to_nanos: i64,
    /// Observations of named states, by state, in order of arrival.
    pub states: Vec<(StateId, Vec<Sample>)>,
    /// The producers of the observations of each entry of `states`; as many entries as `states`.
    pub origins: Vec<Origins>,
    /// Scans of the grid by day.
    pub days: Vec<HistoryDay>,
}

/// The scans of one day, with occupied bits replaced by outliers for the cells that have a model.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryDay {
    /// The scans. For a modelled cell, the occupied bit of a scan that observed it means that the model is wrong there.
    pub outliers: GridDay,
    /// The cells that have a model: tile and models ascending.
    pub models: Vec<(TileId, Vec<OutlierModel>)>,
}

/// The small model against which a cell's outliers are kept. It predicts occupied where mean + Σ 2|γ| cos(ωt + arg γ)
/// reaches 0.5, with t in local civil time. Readings count as 0 and 1 here, whatever the sensor's noise.
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
    /// The imaginary part of γ.
    pub gamma_im: f32,
}

impl HistoryPiece {
    /// A piece without observations.
    pub fn new(generation: u64) -> HistoryPiece {
        let (states, origins, days) = (Vec::new(), Vec::new(), Vec::new());
        HistoryPiece { generation, from_nanos: 0, to_nanos: 0, states, origins, days }
    }

    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        let states: usize = self.states.iter().map(|(_, samples)| size_of_val(samples.as_slice())).sum();
        states + self.days.iter().map(HistoryDay::bytes).sum::<usize>()
    }

    /// The piece with the time range of its observations; `None` without observations.
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
    /// A day without models: its occupied bits are the readings.
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
