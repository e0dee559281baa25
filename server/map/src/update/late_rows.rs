//! States whose rows of changes or events come after an update has learned their time.
//!
//! What a row stands for depends on the rows beside it. A row that comes late changes readings that were learned. So
//! the state is learned anew, from all its rows, where history still has them. Elsewhere the late rows are learned as
//! single readings.
//!
//! Invariant: a state that is learned anew is what it would be had its rows come in order of time.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_grid::spec::Retention;
use tidemap_model::{Sample, StateModel};

use crate::{
    ids::StateId,
    prior_models::PriorModels,
    spec::MapSpec,
    training::{ReadingsRequest, StateReadings, TRAINING_READINGS},
};

/// What is needed to learn states anew.
#[derive(Debug)]
pub(super) struct LateRows<'a> {
    pub(super) spec: &'a MapSpec,
    pub(super) prior_models: &'a PriorModels,
    /// The newest observation of the map, nanoseconds UTC.
    pub(super) newest_nanos: i64,
}

/// States with late rows.
#[derive(Debug, Default)]
pub(super) struct LearnedAnew {
    /// All rows of the states that are learned anew, those of this update included, in order of time.
    pub(super) rows: BTreeMap<StateId, Vec<Sample>>,
    /// States with late rows that are not learned anew.
    pub(super) singly: u64,
    /// Why history of some could not be read.
    pub(super) failure: Option<String>,
}

impl LateRows<'_> {
    /// Resets the models of the states with late rows whose rows history has, and returns all their rows. `states`:
    /// with the rows of this update, in order of arrival. `models`: of all states.
    pub(super) fn begin(
        &self,
        states: &[(StateId, Vec<Sample>)],
        models: &mut [Arc<StateModel>],
        source: Option<&dyn StateReadings>,
    ) -> LearnedAnew {
        let mut found = LearnedAnew::default();
        let late: Vec<&(StateId, Vec<Sample>)> =
            states.iter().filter(|(id, rows)| has_late_rows(models.get(id.0 as usize), rows)).collect();
        found.singly = late.len() as u64;
        let Some(source) = source else { return found };
        let mut room = TRAINING_READINGS;
        for (id, rows) in late {
            let Some(model) = models.get_mut(id.0 as usize) else { continue };
            let Some(learned) = model.learned_rows().copied() else { continue };
            let in_room = room.checked_sub(learned.rows.saturating_add(rows.len() as u64));
            let is_kept = learned.first_nanos.is_some_and(|first_nanos| self.is_kept(first_nanos));
            let Some(left) = in_room.filter(|_| is_kept) else { continue };
            let mut all = match source.readings(&[ReadingsRequest { state: *id, from_nanos: i64::MIN }]) {
                Ok(earlier) => earlier.into_iter().next().unwrap_or_default(),
                Err(reason) => {
                    found.failure.get_or_insert(reason);
                    continue;
                }
            };
            // Some may have been deleted.
            if all.len() as u64 != learned.rows {
                continue;
            }
            all.extend_from_slice(rows);
            // Stable: of equal times the row that came last counts.
            all.sort_by_key(|row| row.utc_nanos);
            *model = self.prior_models.beginning_of(model);
            found.rows.insert(*id, all);
            found.singly -= 1;
            room = left;
        }
        found
    }

    /// Whether history keeps observations of this time. What an update learns must not depend on when others are
    /// deleted.
    fn is_kept(&self, nanos: i64) -> bool {
        match self.spec.retention {
            Retention::None => false,
            Retention::Duration(kept_nanos) => nanos >= self.newest_nanos.saturating_sub(kept_nanos),
            Retention::Forever => true,
        }
    }
}

fn has_late_rows(model: Option<&Arc<StateModel>>, rows: &[Sample]) -> bool {
    let Some((model, learned)) = model.and_then(|model| Some((model, model.learned_rows()?))) else { return false };
    rows.iter().any(|row| learned.is_late(model.reporting(), row.utc_nanos))
}
