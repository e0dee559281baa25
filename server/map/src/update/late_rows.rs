//! Learns states anew whose rows of changes or events come after an update has learned their time.
//!
//! The readings that a row represents depend on the rows beside it. A row that comes late changes readings that were
//! learned. So the state is learned anew from all its rows, where history still has them, and as far as the bound on
//! the work of one update allows: states of lower number first. Otherwise the late rows are learned as single readings.
//!
//! Invariant: a state that is learned anew equals the state whose rows come in order of time.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_grid::spec::Retention;
use tidemap_model::{Sample, StateModel};

use crate::{
    ids::StateId,
    prior_models::PriorModels,
    spec::MapSpec,
    training::{ReadingsRequest, StateReadings, TRAINING_READINGS},
};

/// Maximum number of readings that the rows of all states that one update learns anew represent: about a minute's work.
const READINGS_ANEW: u64 = 20_000_000;

/// The outcome for the states with late rows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LateRowsOutcome {
    /// States that were learned anew.
    pub learned_anew: u64,
    /// States whose late rows are single readings, because history does not keep all their rows.
    pub not_kept: u64,
    /// States whose late rows are single readings, because of the limit of readings that one update learns anew.
    pub beyond_bound: u64,
    /// States whose late rows are single readings, because their history could not be read.
    pub unreadable: u64,
    /// The reason why a history could not be read.
    pub failure: Option<String>,
}

/// The data that is needed to learn states anew.
#[derive(Debug)]
pub(super) struct LateRows<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) prior_models: &'a PriorModels,
    /// The newest time that updates have learned, this one included, nanoseconds UTC.
    pub(super) learned_nanos: i64,
    /// Maximum number of readings that rows represent.
    pub(super) readings_max: u64,
}

/// All rows of the states that are learned anew, those of this update included, in order of time.
pub(super) type AllRows = BTreeMap<StateId, Vec<Sample>>;

impl<'a> LateRows<'a> {
    pub(super) fn new(spec: &'a MapSpec, prior_models: &'a PriorModels, learned_nanos: i64) -> LateRows<'a> {
        LateRows { spec, prior_models, learned_nanos, readings_max: READINGS_ANEW }
    }

    /// Resets the models of the states with late rows whose rows history has, and returns all their rows. `states`: the
    /// states with the rows of this update, in order of arrival. `models`: the models of all states.
    pub(super) fn begin(
        &self,
        states: &[(StateId, Vec<Sample>)],
        models: &mut [Arc<StateModel>],
        source: Option<&dyn StateReadings>,
    ) -> (AllRows, LateRowsOutcome) {
        let (mut found, mut outcome) = (AllRows::new(), LateRowsOutcome::default());
        let (mut rows_left, mut readings_left) = (TRAINING_READINGS, self.readings_max);
        let mut chosen: Vec<(&(StateId, Vec<Sample>), u64)> = Vec::new();
        for state in states {
            let Some(late) = models.get(state.0.0 as usize).and_then(|model| self.late(model, &state.1)) else {
                continue;
            };
            if source.is_none() || !self.is_kept(late.first_nanos) {
                outcome.not_kept += 1;
                continue;
            }
            let left = rows_left.checked_sub(late.rows.saturating_add(state.1.len() as u64));
            match left.zip(readings_left.checked_sub(late.readings)) {
                Some(left) => (rows_left, readings_left) = left,
                None => {
                    outcome.beyond_bound += 1;
                    continue;
                }
            }
            chosen.push((state, late.rows));
        }
        let Some(source) = source.filter(|_| !chosen.is_empty()) else { return (found, outcome) };
        let all = |&((id, _), _): &(&(StateId, Vec<Sample>), u64)| ReadingsRequest { state: *id, from_nanos: i64::MIN };
        let wanted: Vec<ReadingsRequest> = chosen.iter().map(all).collect();
        let earlier = match source.readings(&wanted) {
            Ok(earlier) => earlier,
            Err(reason) => {
                outcome.unreadable = chosen.len() as u64;
                outcome.failure = Some(reason);
                return (found, outcome);
            }
        };
        for (((id, rows), learned), mut all) in chosen.into_iter().zip(earlier) {
            let Some(model) = models.get_mut(id.0 as usize) else { continue };
            // Some rows may have been deleted.
            if all.len() as u64 != learned {
                outcome.not_kept += 1;
                continue;
            }
            all.extend_from_slice(rows);
            // The sort is stable: among equal times, the row that came last counts.
            all.sort_by_key(|row| row.utc_nanos);
            *model = self.prior_models.beginning_of(model);
            found.insert(*id, all);
            outcome.learned_anew += 1;
        }
        (found, outcome)
    }

    /// The data of a state to be learned anew; `None`: no row is late.
    fn late(&self, model: &StateModel, rows: &[Sample]) -> Option<LateState> {
        let (learned, reporting) = (model.learned_rows()?, model.reporting());
        let first_nanos = learned.first_nanos.filter(|_| {
            let is_late = |row: &Sample| learned.is_late(reporting, row.utc_nanos);
            rows.iter().any(is_late)
        })?;
        let earliest_nanos = rows.iter().map(|row| row.utc_nanos).fold(first_nanos, i64::min);
        let step_nanos = reporting.hold()?.step_nanos().max(1).unsigned_abs();
        let readings = self.learned_nanos.max(first_nanos).abs_diff(earliest_nanos) / step_nanos;
        Some(LateState { first_nanos, rows: learned.rows, readings })
    }

    /// Whether history keeps observations of this time. The data that an update learns must not depend on when other
    /// observations are deleted.
    fn is_kept(&self, nanos: i64) -> bool {
        match self.spec.retention {
            Retention::None => false,
            Retention::Duration(kept_nanos) => nanos >= self.learned_nanos.saturating_sub(kept_nanos),
            Retention::Forever => true,
        }
    }
}

/// A state with late rows.
struct LateState {
    /// The first instant that was learned, nanoseconds UTC.
    first_nanos: i64,
    /// Rows that were learned.
    rows: u64,
    /// Maximum number of readings to be learned.
    readings: u64,
}
