//! Prediction intervals: the band in which the mean over the hour around a moment lies with a given probability.
//!
//! Where a state of probabilities has an ensemble, its predictive distribution gives the band and the probability that
//! the band contains the mean. Where a state of other values has an ensemble, its errors at the lead time give the
//! band, and the newest reading narrows it as far as it has made errors smaller; elsewhere the spread of single hours
//! gives it. These bands are stated to have their level.
//!
//! Invariant: a band contains its prediction and lies in the bounds of the state's kind. The band of a probability that
//! was never observed is [0, 1]; a state of another kind has no band then.

use tidemap_grid::view::CellDescription;
use tidemap_model::{
    HeldInterval, StateKind,
    models::{HourMoments, HourTable, Interval, Moment, credible_interval, value_interval, value_interval_of},
    selector::ModelSelector,
};

use crate::{ids::StateId, view::MapView};

const HOUR_SECS: f64 = 3600.0;
const HOUR_NANOS: i64 = 3_600_000_000_000;
/// 1970-01-01 was a Thursday; weeks begin on Monday.
const EPOCH_HOUR_OF_WEEK: i64 = 3 * 24;
/// The band of a state that was never observed.
const NEVER: HeldInterval = HeldInterval { interval: Interval { lower: 0.0, upper: 1.0 }, mass: 1.0 };

/// How much single hours of a state differ, prepared for many predictions.
#[derive(Clone, Debug)]
pub struct Spreads {
    /// The spread by hour of the day, first of weekdays, then of weekends.
    hours: Vec<HourMoments>,
    all: HourMoments,
}

impl Spreads {
    pub(crate) fn of(table: &HourTable) -> Spreads {
        let hour = |(weekend, hour)| table.spread(hour, weekend).map_or_else(HourMoments::default, HourMoments::from);
        let hours: Vec<HourMoments> =
            [false, true].into_iter().flat_map(|weekend| (0..24).map(move |h| (weekend, h))).map(hour).collect();
        let all = hours.iter().fold(HourMoments::default(), |all, &hour| all.and(hour));
        Spreads { hours, all }
    }

    /// The band of a prediction `p` at a moment: it holds the mean over the hour around it with probability `level`.
    pub fn interval(&self, p: f64, at: Moment, level: f64) -> Interval {
        credible_interval(p, self.hour(at), self.all, level)
    }

    /// The band of a prediction for continuous and count states, in the same way as [`Spreads::interval`]. `readings`:
    /// the variance of single readings.
    pub fn value_interval(&self, kind: StateKind, p: f64, at: Moment, readings: f64, level: f64) -> Interval {
        value_interval(kind, p, self.hour(at), readings, level)
    }

    /// Variance between days of a moment's hour of the day; 0 with fewer than two days.
    pub(crate) fn variance_between_days(&self, at: Moment) -> f64 {
        self.hour(at).variance()
    }

    /// The record of a moment's hour of the day.
    fn hour(&self, at: Moment) -> HourMoments {
        let hour_of_week = (at.civil_nanos().div_euclid(HOUR_NANOS) + EPOCH_HOUR_OF_WEEK).rem_euclid(168);
        let (day, hour) = (hour_of_week / 24, hour_of_week % 24);
        let index = hour + if day >= 5 { 24 } else { 0 };
        usize::try_from(index).ok().and_then(|index| self.hours.get(index)).copied().unwrap_or_default()
    }
}

impl MapView {
    /// How much single hours of a state differ; `None` for an untrained state.
    pub(crate) fn spreads(&self, id: StateId) -> Option<Spreads> {
        self.model(id).alternatives().map(|known| Spreads::of(known.hours()))
    }

    /// The bands of predictions of a state by a model. `None` without a level, and for a continuous or count state with
    /// fewer than two learned observations.
    pub fn intervals(
        &self,
        id: StateId,
        (moments, probabilities): (&[Moment], &[f64]),
        selector: ModelSelector,
        level: Option<f64>,
    ) -> Vec<HeldInterval> {
        let Some(level) = level else { return Vec::new() };
        if let Some(around) = self.model(id).predictive_around(moments, probabilities) {
            return around.into_iter().map(|predicted| predicted.interval(level)).collect();
        }
        let held = |interval: Interval| HeldInterval { interval, mass: level };
        let spreads = self.spreads(id);
        let (kind, folded) = (self.kind(id), self.model(id).accumulator());
        if kind != StateKind::Probability {
            let Some(spreads) = spreads.filter(|_| folded.observations() >= 2) else { return Vec::new() };
            if let Some(variances) = self.variances(id, moments, probabilities, selector) {
                let pairs = variances.into_iter().zip(probabilities);
                return pairs.map(|(variance, &p)| held(value_interval_of(kind, p, variance, level))).collect();
            }
            let readings = folded.variance();
            let pairs = moments.iter().zip(probabilities);
            return pairs.map(|(&at, &p)| held(spreads.value_interval(kind, p, at, readings, level))).collect();
        }
        let interval = |(&moment, &p): (&Moment, &f64)| match &spreads {
            Some(spreads) => held(spreads.interval(p, moment, level)),
            None => NEVER,
        };
        moments.iter().zip(probabilities).map(interval).collect()
    }

    /// The expected squared distances of the means of hours from predictions by a model; `None` where no ensemble of
    /// numbers predicts.
    fn variances(&self, id: StateId, moments: &[Moment], values: &[f64], selector: ModelSelector) -> Option<Vec<f64>> {
        let model = self.model(id);
        if !selector.knows_newest() {
            return model.variances_around(&self.spec.periodicities, moments, values);
        }
        let variances = model.variances(moments)?;
        let (Some((newest, _)), Some(belief)) = (self.live(id).persistence.last(), model.belief()) else {
            return Some(variances);
        };
        let is_learned = self.has_learned(id, newest);
        let share = |at: &Moment| belief.error_share(newest, is_learned, at.utc_nanos);
        Some(moments.iter().zip(variances).map(|(at, variance)| variance * share(at)).collect())
    }
}

/// The bands of predictions of a cell; `None` without a level. A cell has no record of single hours. As a two-state
/// Markov chain with time constant τ (T-RO 2017 eq. 12), its mean over an hour T varies by p(1 - p)·(2τ/T)(1 - (τ/T)(1
/// - e^(-T/τ))), and each hour of its observations counts as one observed hour.
pub fn cell_intervals(cell: &CellDescription, probabilities: &[f64], level: Option<f64>) -> Vec<HeldInterval> {
    let Some(level) = level else { return Vec::new() };
    let Some(hours) = observed_hours(cell) else { return vec![NEVER; probabilities.len()] };
    let ratio = cell.persistence.tau_secs() / HOUR_SECS;
    let alike = if ratio > 1e6 { 1.0 } else { 2.0 * ratio * (1.0 - ratio * (1.0 - libm::exp(-1.0 / ratio))) };
    let interval = |&p: &f64| {
        let moments = HourMoments {
            days: hours,
            sum: hours * p,
            sum_of_squares: hours * (p * p + p * (1.0 - p) * alike.clamp(0.0, 1.0)),
        };
        HeldInterval { interval: credible_interval(p, moments, moments, level), mass: level }
    };
    probabilities.iter().map(interval).collect()
}

/// The approximate number of times that an hour of the day was observed, which is the number of days from the first
/// observation to the last: never more than the cell's observations.
fn observed_hours(cell: &CellDescription) -> Option<f64> {
    let first_nanos = cell.first_nanos?;
    let last_nanos = cell.persistence.last().map_or(first_nanos, |(nanos, _)| nanos);
    let days = last_nanos.abs_diff(first_nanos) as f64 / 86_400e9 + 1.0;
    Some(days.min(cell.folded as f64)).filter(|&days| days >= 1.0)
}

#[cfg(test)]
mod tests {
    use tidemap_model::{HoursSeen, Persistence, PersistenceParts, Sample, SpectralModel};

    use super::*;

    const DAY_NANOS: i64 = 24 * HOUR_NANOS;

    #[test]
    fn bands_widen_where_little_was_observed_and_hold_the_prediction() {
        // The record is from a Thursday, every ten minutes for six weeks: open from 10 to 11, and on every third day
        // from 9 to 12.
        let sample = |slot: i64| {
            let (day, hour) = (slot / 144, slot % 144 / 6);
            let value = if (9..12).contains(&hour) && (hour == 10 || day % 3 == 0) { 1.0 } else { 0.0 };
            Sample { utc_nanos: slot * HOUR_NANOS / 6, offset_secs: 0, value }
        };
        let table = |days: i64| {
            let mut table = HourTable::default();
            table.add(&(0..days * 144).map(sample).collect::<Vec<_>>());
            Spreads::of(&table)
        };
        let at = |day: i64, hour: i64| Moment { utc_nanos: day * DAY_NANOS + hour * HOUR_NANOS, offset_secs: 0 };
        let (few, many) = (table(4), table(42));
        for (p, moment) in [(0.4, at(50, 9)), (0.98, at(50, 10)), (0.01, at(50, 3))] {
            let (wide, narrow) = (few.interval(p, moment, 0.9), many.interval(p, moment, 0.9));
            assert!(wide.contains(p) && narrow.contains(p), "{wide:?} {narrow:?}");
            assert!(narrow.width() <= wide.width() + 1e-9, "{wide:?} {narrow:?}");
        }
        // The value of an hour that is 0 or 1 from day to day is less sure than that of an hour that is always the
        // same.
        let (unsure, sure) = (many.interval(0.4, at(50, 9), 0.9), many.interval(0.01, at(50, 3), 0.9));
        assert!(unsure.width() > 0.5 && sure.width() < 0.1, "{unsure:?} {sure:?}");
        // Saturday and Sunday were observed only in a shorter record.
        assert_eq!(table(2).interval(0.3, at(2, 9), 0.9), NEVER.interval);
    }

    #[test]
    fn a_cell_that_changes_slowly_is_less_sure_than_one_that_flickers() {
        let cell = |tau_secs: f64| CellDescription {
            changed: true,
            spectral: SpectralModel::default(),
            order: 0,
            errors: None,
            alarm_day: None,
            persistence: Persistence::from_parts(PersistenceParts {
                pairs: 999,
                change_rate_sum: 1000.0 / tau_secs,
                last: Some((40 * DAY_NANOS, 1.0)),
            })
            .expect("valid"),
            folded: 1000,
            observations: 1000,
            first_nanos: Some(0),
            seen: HoursSeen::default(),
        };
        let width = |tau_secs| cell_intervals(&cell(tau_secs), &[0.4], Some(0.9))[0].interval.width();
        assert!(width(10.0) < 0.5 * width(36_000.0), "{} {}", width(10.0), width(36_000.0));
        let unseen = CellDescription { first_nanos: None, ..cell(10.0) };
        assert_eq!(cell_intervals(&unseen, &[0.5], Some(0.9)), [NEVER]);
    }
}
