//! The small models of a day's cells, evaluated at the day's scans.
//!
//! Invariant: the predictions of a model depend only on its parts and on the times of the scans, to the last bit: sums
//! are in f32, in the order of the components. Memory for phasors is bounded; phasors beyond the bound are computed
//! again each time.

use std::sync::{
    OnceLock,
    atomic::{AtomicUsize, Ordering},
};

use tidemap_grid::day::ScanTime;
use tidemap_model::Periodicities;

use super::{OutlierComponent, bits::Bits, turn::Phases};

/// Bytes of phasors that are held for one day.
const BYTES_MAX: usize = 128 << 20;
/// A sum from this value on counts as occupied.
const THRESHOLD: f32 = 0.5;

/// Cosines and sines of some times in one periodicity.
#[derive(Debug, Default)]
struct Row {
    cos: Vec<f32>,
    sin: Vec<f32>,
}

/// The phasors of a day's scans, each row computed at its first use.
#[derive(Debug)]
pub(super) struct DayPhasors {
    phases: Phases,
    rows: Vec<OnceLock<Row>>,
    /// Number of rows that may still be held.
    room: AtomicUsize,
}

impl DayPhasors {
    pub(super) fn new(periodicities: &Periodicities, scans: &[ScanTime]) -> DayPhasors {
        let phases = Phases::new(periodicities, scans.iter().map(ScanTime::civil_nanos));
        let rows = std::iter::repeat_with(OnceLock::new).take(phases.count()).collect();
        let room = BYTES_MAX / (8 * scans.len()).max(1);
        DayPhasors { phases, rows, room: AtomicUsize::new(room) }
    }

    /// Number of scans.
    pub(super) fn scans(&self) -> usize {
        self.phases.times()
    }

    /// The row of a periodicity, where there is one.
    fn row<'a>(&'a self, k: usize, own: &'a mut Row) -> Option<&'a Row> {
        let held = self.rows.get(k)?;
        if let Some(row) = held.get() {
            return Some(row);
        }
        let compute = |row: &mut Row| self.phases.cos_sin_into(k, &mut row.cos, &mut row.sin);
        let has_room = self.room.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |room| room.checked_sub(1)).is_ok();
        if !has_room {
            compute(own);
            return Some(own);
        }
        Some(held.get_or_init(|| {
            let mut row = Row::default();
            compute(&mut row);
            row
        }))
    }
}

/// A model's sum over the scans of a day, component after component.
#[derive(Debug, Default)]
pub(super) struct Sum {
    values: Vec<f32>,
    own: Row,
}

impl Sum {
    /// Sets the sum to the mean alone.
    pub(super) fn start(&mut self, mean: f32, phasors: &DayPhasors) {
        self.values.clear();
        self.values.resize(phasors.scans(), mean);
    }

    /// Adds a component; a component with a periodicity that does not exist adds nothing.
    pub(super) fn add(&mut self, component: &OutlierComponent, phasors: &DayPhasors) {
        let Sum { values, own } = self;
        let Some(row) = phasors.row(usize::from(component.periodicity), own) else { return };
        let (by_cos, by_sin) = (2.0 * component.gamma_re, -2.0 * component.gamma_im);
        for ((value, cos), sin) in values.iter_mut().zip(&row.cos).zip(&row.sin) {
            *value += by_cos * cos + by_sin * sin;
        }
    }

    /// Sets the bits of the scans at which the model predicts occupied.
    pub(super) fn occupied(&self, bits: &mut Bits) {
        bits.fill_reaching(&self.values, THRESHOLD);
    }
}
