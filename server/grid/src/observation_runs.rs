//! Keeps the times at which the cells of a tile were observed, as runs of scans instead of sums.
//!
//! A robot that sees nearly every cell at different times makes nearly every cell an observation group of its own. A
//! sum for each group would be most of a map's data, although only cells that change need a sum. So above a number of
//! groups the observations are kept run-length coded, and the sum of a cell is computed at its first change. When the
//! runs take more memory than the sums would, the sums are computed and the runs dropped: a tile never takes more than
//! twice the memory of the smaller of the two forms.
//!
//! Invariant: a cell is in at most one list of a day; toggles ascend and are below the number of the day's scans,
//! except the last toggle of a run that the last scan does not end.

use std::sync::Arc;

use tidemap_model::{LocalDay, Periodicities, PhasorSum, PhasorTable, RunningSums};

use crate::{
    fade::HalfLife,
    fold::{Chunk, Cursor, WeightedRows, WeightedScans, fold_toggles},
    index::TILE_CELLS,
    mask::Mask,
    sensor_sums::{GroupSums, WeightedSums},
    sensors::{SensorId, Sensors},
};

/// Cells that were observed at the same times of a day.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellRuns {
    /// The cells, ascending.
    pub cells: Box<[u16]>,
    /// Ascending numbers of scans at which the observed bit changes; not observed before the first.
    pub toggles: Box<[u32]>,
}

/// The times at which cells of a tile were observed on one day.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DayRuns {
    /// Local civil times of the scans that saw the tile, in nanoseconds since 1970 local. Tiles seen by the same scans
    /// share them.
    pub civil_nanos: Arc<[i64]>,
    /// The sensors of these scans, in their order; `None` where all are the map's own. Tiles seen by the same scans
    /// share them too.
    pub sensors: Option<Arc<Vec<SensorId>>>,
    /// Cells that were observed at the same times.
    pub lists: Vec<CellRuns>,
}

impl DayRuns {
    /// The local date of the scans.
    fn day(&self) -> Option<LocalDay> {
        self.civil_nanos.first().map(|&nanos| LocalDay::of_civil_nanos(nanos))
    }
}

/// The times at which the cells of a tile were observed since the tile had too many groups to keep a sum for each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ObservationRuns {
    days: Vec<DayRuns>,
}

/// Why stored runs are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the runs in which cells were observed are not valid")]
pub struct InvalidRuns;

impl ObservationRuns {
    /// Decodes stored runs.
    ///
    /// # Errors
    /// [`InvalidRuns`] where the invariant does not hold.
    pub fn from_days(days: Vec<DayRuns>) -> Result<ObservationRuns, InvalidRuns> {
        for day in &days {
            if day.sensors.as_ref().is_some_and(|sensors| sensors.len() != day.civil_nanos.len()) {
                return Err(InvalidRuns);
            }
            let mut seen = Mask::EMPTY;
            for list in &day.lists {
                for &cell in &list.cells {
                    if usize::from(cell) >= TILE_CELLS || seen.contains(cell) {
                        return Err(InvalidRuns);
                    }
                    seen.insert(cell);
                }
                let ascend = list.toggles.is_sorted_by(|one, next| one < next);
                if !ascend || list.toggles.last().is_some_and(|&last| last as usize >= day.civil_nanos.len()) {
                    return Err(InvalidRuns);
                }
            }
        }
        Ok(ObservationRuns { days })
    }

    /// The days, in the order in which they were learned.
    pub fn days(&self) -> &[DayRuns] {
        &self.days
    }

    /// Whether no run is kept: the sums of all groups are whole.
    pub fn is_empty(&self) -> bool {
        self.days.is_empty()
    }

    /// Adds a day: the times and sensors of the scans that saw the tile, and the toggles of the observed bit of its
    /// cells.
    pub(super) fn push<'a>(
        &mut self,
        civil_nanos: &Arc<[i64]>,
        sensors: Option<&Arc<Vec<SensorId>>>,
        observed: impl Iterator<Item = (&'a Vec<u32>, Mask)>,
    ) {
        let lists: Vec<CellRuns> = observed
            .filter(|(_, cells)| !cells.is_empty())
            .map(|(toggles, cells)| {
                debug_assert!(toggles.is_sorted_by(|a, b| a < b), "toggles ascend: {toggles:?}");
                CellRuns { cells: cells.cells().collect(), toggles: toggles.as_slice().into() }
            })
            .collect();
        if !lists.is_empty() {
            self.days.push(DayRuns { civil_nanos: Arc::clone(civil_nanos), sensors: sensors.cloned(), lists });
        }
    }

    /// The sums over the times at which each of these cells was observed, in the order of the cells. With a half-life,
    /// each day counts with its weight on the day that is given with the cell.
    pub(super) fn sums(
        &self,
        cells: &[(u16, Option<LocalDay>)],
        half_life: Option<HalfLife>,
        periodicities: &Periodicities,
        sensors: &Sensors,
        chunk_scans: usize,
    ) -> Vec<GroupSums> {
        let has_others = self.days.iter().any(|day| day.sensors.is_some());
        let mut sums: Vec<CellSums> = cells.iter().map(|_| CellSums::zero(periodicities, has_others)).collect();
        for day in &self.days {
            let mut wanted: Vec<WantedCell<'_>> = Vec::new();
            for (&(cell, on), sum) in cells.iter().zip(&mut sums) {
                if let Some(list) = day.lists.iter().find(|list| list.cells.binary_search(&cell).is_ok()) {
                    let factor =
                        half_life.zip(day.day().zip(on)).map(|(half_life, (from, to))| half_life.factor(from, to));
                    let faded = factor.filter(|&factor| factor != 1.0);
                    let faded = faded.map(|factor| (CellSums::zero(periodicities, has_others), factor));
                    wanted.push(WantedCell { toggles: &list.toggles, cursor: Cursor::default(), sum, faded });
                }
            }
            if wanted.is_empty() {
                continue;
            }
            let weighted = day.sensors.as_ref().map(|ids| WeightedScans::new(Arc::clone(ids), sensors));
            let mut rows = RunningSums::new(periodicities);
            let mut weighted_rows = weighted.as_ref().map(|_| WeightedRows::new(periodicities));
            for (number, civil_nanos) in day.civil_nanos.chunks(chunk_scans).enumerate() {
                let first = number * chunk_scans;
                let phasors = PhasorTable::new(periodicities, civil_nanos);
                rows.extend_chunk(&phasors);
                if let (Some(rows), Some(weighted)) = (&mut weighted_rows, &weighted) {
                    rows.extend_chunk(&phasors, weighted, first);
                }
                let is_last = first + civil_nanos.len() == day.civil_nanos.len();
                let weighted = weighted_rows.as_ref();
                let chunk = Chunk { first, rows: &rows, weighted, scans: civil_nanos.len(), is_last };
                for WantedCell { toggles, cursor, sum, faded } in &mut wanted {
                    let sum = faded.as_mut().map_or(&mut **sum, |(sum, _)| sum);
                    let from = *cursor;
                    fold_toggles(toggles, cursor, &mut sum.plain, &rows, &chunk);
                    if let Some((alpha, beta)) = &mut sum.weighted {
                        // On a day with the map's own sensor only, α is 0 and β is 1.
                        if let Some(weighted) = weighted {
                            fold_toggles(toggles, &mut { from }, alpha, &weighted.alpha, &chunk);
                        }
                        let rows = weighted.map_or(&rows, |weighted| &weighted.beta);
                        fold_toggles(toggles, &mut { from }, beta, rows, &chunk);
                    }
                }
            }
            for WantedCell { sum, faded, .. } in wanted {
                if let Some((faded, factor)) = faded {
                    sum.add_scaled(&faded, factor);
                }
            }
        }
        sums.into_iter().map(CellSums::finish).collect()
    }

    /// Memory in bytes, about; times that tiles share are counted as if they were not.
    pub fn bytes(&self) -> usize {
        let of_list = |list: &CellRuns| size_of::<CellRuns>() + size_of_val(&*list.cells) + size_of_val(&*list.toggles);
        let of_day = |day: &DayRuns| {
            let sensors = day.sensors.as_ref().map_or(0, |sensors| sensors.len());
            let lists = day.lists.iter().map(of_list).sum::<usize>();
            size_of::<DayRuns>() + size_of_val(&*day.civil_nanos) + sensors + lists
        };
        self.days.iter().map(of_day).sum()
    }
}

/// The sums of one cell, while they are computed.
struct CellSums {
    plain: PhasorSum,
    /// The sums weighted by α and by β.
    weighted: Option<(PhasorSum, PhasorSum)>,
}

/// A cell whose sums are requested, on one day.
struct WantedCell<'a> {
    toggles: &'a [u32],
    cursor: Cursor,
    sum: &'a mut CellSums,
    /// The day's own sums and their weight, if it counts less than 1.
    faded: Option<(CellSums, f64)>,
}

impl CellSums {
    fn zero(periodicities: &Periodicities, has_others: bool) -> CellSums {
        let zero = || PhasorSum::zero(periodicities);
        CellSums { plain: zero(), weighted: has_others.then(|| (zero(), zero())) }
    }

    fn add_scaled(&mut self, other: &CellSums, factor: f64) {
        self.plain.add_scaled(&other.plain, factor);
        if let (Some((alpha, beta)), Some((other_alpha, other_beta))) = (&mut self.weighted, &other.weighted) {
            alpha.add_scaled(other_alpha, factor);
            beta.add_scaled(other_beta, factor);
        }
    }

    fn finish(self) -> GroupSums {
        let weighted = self.weighted.map(|(alpha, beta)| WeightedSums { alpha: Arc::new(alpha), beta: Arc::new(beta) });
        GroupSums { plain: Arc::new(self.plain), weighted, times: None }
    }
}
