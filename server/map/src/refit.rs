//! Fitting calibrated models again at the end of an update, to the readings that updates have folded in.
//!
//! Invariant: what is fitted depends on the readings, the models and the map's properties alone: an update that is repeated
//! from the same history fits the same. Readings that cannot be had cost the fit, and nothing else of the update.

use std::{fmt, sync::Arc};

use rayon::prelude::*;
use tidemap_model::{
    LocalDay, Sample, StateModel,
    family::{Calibrated, CalibratedOptions, CannotFit, Readings},
};

use crate::{event::StateId, grid::spec::Retention, spec::MapSpec};

#[cfg(test)]
mod tests;

/// Most models that an update fits, so that a night of very many states has an end. Those that have waited longest go
/// first; the others wait for the next update that folds something of theirs in.
pub const REFITS_MAX: usize = 2_000;

/// A model is fitted to what is no older than this against the state's newest reading: twelve weeks. Older days would hardly
/// count, by the memory of [`CalibratedOptions`].
pub const REFIT_NANOS: i64 = 84 * 86_400 * 1_000_000_000;

/// Most readings of a state that its model is fitted to, about: where it was read more often, it is fitted to fewer days.
/// The readings of as many states are in memory at once as have so many together, and those of the next ones: 200 MB.
pub const REFIT_READINGS: u64 = 4_000_000;

/// The readings that are wanted of a state: those at this instant and later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WantedReadings {
    /// The state.
    pub state: StateId,
    /// The first instant, nanoseconds UTC.
    pub from_nanos: i64,
}

/// Where the readings come from that updates have folded in.
pub trait StateReadings: fmt::Debug + Send + Sync {
    /// What the updates before the one that asks have folded in of each of these states: as many lists as are wanted, in
    /// their order, each ascending by time; of equal times in the order of the updates, then of arrival.
    ///
    /// # Errors
    /// Why they cannot be had.
    fn readings(&self, wanted: &[WantedReadings]) -> Result<Vec<Vec<Sample>>, String>;
}

/// What became of the calibrated models that were due.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Refits {
    /// Models that were fitted.
    pub fitted: u64,
    /// States that wait, because an update fits no more than [`REFITS_MAX`].
    pub waiting: u64,
    /// States that keep the model that they have, because their readings could not be had.
    pub failed: u64,
    /// Why the first of those could not be had.
    pub failure: Option<String>,
}

/// What a round of fits may take.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Models.
    refits: usize,
    /// Readings of one state, and of those whose models are fitted at the same time.
    readings: u64,
}

const LIMITS: Limits = Limits { refits: REFITS_MAX, readings: REFIT_READINGS };

/// A state whose model is due.
#[derive(Clone, Copy)]
struct Due<'a> {
    wanted: WantedReadings,
    /// What this update has folded in.
    own: &'a [Sample],
    /// The day of the last fit; never fitted goes before all.
    fitted: Option<LocalDay>,
    /// The last day folded in.
    day: LocalDay,
    /// Readings to expect, not fewer than one.
    expected: u64,
}

/// Fits the models of the states that this update has folded `own` into, where it is due, on the threads of the rayon pool
/// that this is called in. `newest_nanos`: the greatest time of the map's observations, by which it forgets.
pub(crate) fn refit(
    spec: &MapSpec,
    newest_nanos: i64,
    own: &[(StateId, Vec<Sample>)],
    models: &mut [Arc<StateModel>],
    source: &dyn StateReadings,
) -> Refits {
    refit_within(LIMITS, spec, newest_nanos, own, models, source)
}

fn refit_within(
    limits: Limits,
    spec: &MapSpec,
    newest_nanos: i64,
    own: &[(StateId, Vec<Sample>)],
    models: &mut [Arc<StateModel>],
    source: &dyn StateReadings,
) -> Refits {
    // History may have been deleted up to here, or not yet: a model must not depend on that.
    let kept_from = match spec.retention {
        Retention::None => return Refits::default(),
        Retention::Duration(nanos) => newest_nanos.saturating_sub(nanos),
        Retention::Forever => i64::MIN,
    };
    let mut due: Vec<Due<'_>> = own
        .iter()
        .filter_map(|(id, own)| due(*id, models.get(id.0 as usize)?, own, kept_from, limits.readings))
        .collect();
    due.sort_by_key(|due| due.fitted);
    let waiting = due.len().saturating_sub(limits.refits) as u64;
    due.truncate(limits.refits);
    // As history has them.
    due.sort_by_key(|due| due.wanted.state);
    let mut batches = Batches { rest: &due, readings_max: limits.readings, source };
    let mut refits = Refits { waiting, ..Refits::default() };
    let mut next = batches.next();
    while let Some((batch, found)) = next {
        // The next ones are read meanwhile.
        let fit =
            || found.map(|found| batch.par_iter().zip(found).map(|(due, earlier)| fit(spec, due, earlier)).collect());
        let fitted: Result<Vec<_>, String>;
        (fitted, next) = rayon::join(fit, || batches.next());
        match fitted {
            Ok(fitted) => {
                for (due, calibrated) in batch.iter().zip(fitted) {
                    // Where there are no readings after all, the state goes on with what it has.
                    if let (Ok(calibrated), Some(model)) = (calibrated, models.get_mut(due.wanted.state.0 as usize)) {
                        *model = Arc::new(StateModel::clone(model).refitted(calibrated, due.day));
                        refits.fitted += 1;
                    }
                }
            }
            Err(reason) => {
                refits.failed += batch.len() as u64;
                refits.failure.get_or_insert(reason);
            }
        }
    }
    refits
}

/// The states that are due, with the readings of earlier updates, as many at a time as may be in memory.
struct Batches<'a> {
    rest: &'a [Due<'a>],
    readings_max: u64,
    source: &'a dyn StateReadings,
}

impl<'a> Iterator for Batches<'a> {
    type Item = (&'a [Due<'a>], Result<Vec<Vec<Sample>>, String>);

    fn next(&mut self) -> Option<Self::Item> {
        let (batch, rest) = self.rest.split_at(batch_len(self.rest, self.readings_max));
        self.rest = rest;
        if batch.is_empty() {
            return None;
        }
        let wanted: Vec<WantedReadings> = batch.iter().map(|due| due.wanted).collect();
        let found = self.source.readings(&wanted).and_then(|found| match found.len() == wanted.len() {
            true => Ok(found),
            false => Err(format!("of {} states readings of {} were found", wanted.len(), found.len())),
        });
        Some((batch, found))
    }
}

/// What is to be fitted of a state, if anything is.
fn due<'a>(
    state: StateId,
    model: &StateModel,
    own: &'a [Sample],
    kept_from: i64,
    readings_max: u64,
) -> Option<Due<'a>> {
    let known = model.alternatives().filter(|_| model.is_refit_due())?;
    let (folded, day) = (model.accumulator(), known.folded_day()?);
    let newest = folded.last_nanos()?;
    let span_nanos = newest.abs_diff(folded.first_nanos()?).max(1) as f64;
    let window_nanos = span_nanos.min(REFIT_NANOS as f64);
    // As if it had always been read as often.
    let expected = folded.observations() as f64 * (window_nanos / span_nanos);
    let share = (readings_max as f64 / expected.max(1.0)).min(1.0);
    let from_nanos = newest.saturating_sub((window_nanos * share) as i64).max(kept_from);
    let fitted = known.calibrated().map(|(_, day)| day);
    let expected = ((expected * share) as u64).max(1);
    Some(Due { wanted: WantedReadings { state, from_nanos }, own, fitted, day, expected })
}

/// How many of the states that are due are worked off together: at least one, if there are any.
fn batch_len(due: &[Due<'_>], readings_max: u64) -> usize {
    let mut readings = 0_u64;
    let fits = due.iter().take_while(|due| {
        readings = readings.saturating_add(due.expected);
        readings <= readings_max
    });
    fits.count().max(1).min(due.len())
}

fn fit(spec: &MapSpec, due: &Due<'_>, earlier: Vec<Sample>) -> Result<Calibrated, CannotFit> {
    let mut samples = earlier;
    samples.extend(due.own.iter().filter(|sample| sample.utc_nanos >= due.wanted.from_nanos));
    // Stable: of equal times those of earlier updates come first.
    samples.sort_by_key(|sample| sample.utc_nanos);
    let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
    Calibrated::fit(Readings { samples: &samples, half_life_secs }, CalibratedOptions::default())
}
