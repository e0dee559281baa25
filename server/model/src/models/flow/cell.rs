//! The detections of one cell, and the rates that follow from them.
//!
//! The sums run over the intervals with detections only. The other intervals add nothing to Σ w n e^(-jωt), and their
//! contribution to the mean is equal for all cells ([`IntervalSum`]).
//!
//! Invariant: a rate is positive and finite.

use super::{
    FlowOptions,
    intervals::{FlowIntervals, IntervalSum},
};
use crate::{Component, ORDER_MAX, Periodicities, PhasorTable};

/// The prior of a cell: half a detection in all directions …
const PRIOR_EVENTS: f64 = 0.5;
/// … in one interval.
const PRIOR_INTERVALS: f64 = 1.0;
/// A lower order is preferred if its log-likelihood is within this of the highest, as in [`crate::models::poisson`].
const NEAR_TIE_NATS: f64 = 3.0;

/// Mean detections of an interval in one direction, by the prior alone.
pub(super) fn prior_mean(directions: usize, weight: f64) -> f64 {
    PRIOR_EVENTS / directions as f64 / (PRIOR_INTERVALS + weight)
}

/// The rates of a cell, in detections of an interval.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CellRates {
    pub(super) cell: usize,
    pub(super) order: usize,
    /// The rates by direction.
    pub(super) rates: Vec<DirectionRate>,
}

/// The rate of one direction of a cell: a mean and its strongest periodic components.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DirectionRate {
    mean: f64,
    floor: f64,
    components: Vec<Component>,
}

impl DirectionRate {
    /// The rate at a time of a table.
    pub(super) fn at(&self, phasors: &PhasorTable, time: usize) -> f64 {
        let mut rate = self.mean;
        for component in &self.components {
            if let Some((cos, sin)) = phasors.row(component.periodicity) {
                rate += 2.0 * (component.gamma_re * cos[time] - component.gamma_im * sin[time]);
            }
        }
        rate.max(self.floor)
    }
}

/// The detections of a cell.
pub(super) struct CellCounts {
    /// The intervals with detections and their number, ascending, by direction.
    directions: Vec<Vec<(usize, f64)>>,
}

impl CellCounts {
    pub(super) fn new(directions: usize) -> CellCounts {
        CellCounts { directions: vec![Vec::new(); directions] }
    }

    /// Adds a detection that is in no earlier interval than those before it.
    pub(super) fn add(&mut self, direction: usize, interval: usize) {
        match self.directions[direction].last_mut() {
            // An hour that the clock repeats goes back in civil time: it counts in the interval that was reached.
            Some((last, count)) if *last >= interval => *count += 1.0,
            _ => self.directions[direction].push((interval, 1.0)),
        }
    }

    /// The rates of all directions with components up to an order, from the first intervals, which `sum` sums.
    pub(super) fn rates(
        &self,
        sum: &IntervalSum,
        intervals: &FlowIntervals,
        periodicities: &Periodicities,
        order: usize,
    ) -> Vec<DirectionRate> {
        self.rates_before(intervals.len(), sum, intervals, periodicities, order)
    }

    fn rates_before(
        &self,
        end: usize,
        sum: &IntervalSum,
        intervals: &FlowIntervals,
        periodicities: &Periodicities,
        order: usize,
    ) -> Vec<DirectionRate> {
        let prior = prior_mean(self.directions.len(), sum.weight);
        let of_direction = |counts: &Vec<(usize, f64)>| {
            let known = &counts[..counts.partition_point(|(interval, _)| *interval < end)];
            let weighted: f64 =
                known.iter().map(|(interval, count)| sum.scale * intervals.weight(*interval) * count).sum();
            let mean = prior + weighted / (PRIOR_INTERVALS + sum.weight);
            let components = if order == 0 || known.is_empty() {
                Vec::new()
            } else {
                strongest(known, weighted / sum.weight, sum, intervals, periodicities, order)
            };
            // The floor is the rate of a time of day that was observed on so many days without any detection.
            let floor = (PRIOR_EVENTS / self.directions.len() as f64 / (PRIOR_INTERVALS + sum.days as f64)).min(mean);
            DirectionRate { mean, floor, components }
        };
        self.directions.iter().map(of_direction).collect()
    }
}

/// The strongest components γ_k = Σ w n e^(-jω_k t) / W - μ Σ w e^(-jω_k t) / W; of equal ones the lower index first.
fn strongest(
    counts: &[(usize, f64)],
    mean: f64,
    sum: &IntervalSum,
    intervals: &FlowIntervals,
    periodicities: &Periodicities,
    order: usize,
) -> Vec<Component> {
    let times: Vec<i64> = counts.iter().map(|(interval, _)| intervals.centre_nanos(*interval)).collect();
    let shares: Vec<f64> =
        counts.iter().map(|(interval, count)| sum.scale * intervals.weight(*interval) * count / sum.weight).collect();
    let table = PhasorTable::new(periodicities, &times);
    let of_sum = |watched: &Component| {
        let (cos, sin) = table.row(watched.periodicity)?;
        let over = |row: &[f64]| row.iter().zip(&shares).map(|(phasor, share)| phasor * share).sum::<f64>();
        let (gamma_re, gamma_im) = (over(cos) - mean * watched.gamma_re, -over(sin) - mean * watched.gamma_im);
        Some(Component { periodicity: watched.periodicity, gamma_re, gamma_im })
    };
    let mut found: Vec<Component> = sum.phasors.iter().filter_map(of_sum).collect();
    found.retain(|component| component.amplitude() > 0.0);
    found.sort_by(|one, other| other.amplitude().total_cmp(&one.amplitude()));
    found.truncate(order.min(ORDER_MAX));
    // The vector is shrunk because the model keeps it.
    found.shrink_to_fit();
    found
}

/// The held-out days that choose orders, which are the last ones, and the data learned from the days before.
pub(super) struct HeldOutDays {
    /// Index of the first held-out interval.
    from: usize,
    learned: IntervalSum,
    periodicities: Periodicities,
    /// Phasors of the held-out intervals.
    phasors: PhasorTable,
}

impl HeldOutDays {
    pub(super) fn of(intervals: &FlowIntervals, from: usize, periodicities: &Periodicities) -> HeldOutDays {
        let times: Vec<i64> = (from..intervals.len()).map(|index| intervals.centre_nanos(index)).collect();
        let phasors = PhasorTable::new(periodicities, &times);
        HeldOutDays { from, learned: intervals.sum(from, periodicities), periodicities: periodicities.clone(), phasors }
    }

    /// The order that predicts the held-out days best, learned from the days before; on a near tie the lowest.
    pub(super) fn best_order(&self, counts: &CellCounts, intervals: &FlowIntervals, options: &FlowOptions) -> usize {
        let order_max = options.order_max.min(ORDER_MAX);
        let rates = counts.rates_before(self.from, &self.learned, intervals, &self.periodicities, order_max);
        // Log-likelihood by order, without ln(count!), which is equal for every order.
        let mut found = vec![0.0; order_max + 1];
        for (rate, counts) in rates.iter().zip(&counts.directions) {
            let held = &counts[counts.partition_point(|(interval, _)| *interval < self.from)..];
            let mut expected = vec![rate.mean; self.phasors.len()];
            for (order, found) in found.iter_mut().enumerate() {
                if let Some(component) = order.checked_sub(1).and_then(|last| rate.components.get(last))
                    && let Some((cos, sin)) = self.phasors.row(component.periodicity)
                {
                    let (re, im) = (2.0 * component.gamma_re, 2.0 * component.gamma_im);
                    for ((expected, cos), sin) in expected.iter_mut().zip(cos).zip(sin) {
                        *expected += re * cos - im * sin;
                    }
                }
                let of_count = |(interval, count): &(usize, f64)| {
                    count * libm::log(expected[interval - self.from].max(rate.floor))
                };
                *found += held.iter().map(of_count).sum::<f64>();
                *found -= expected.iter().map(|expected| expected.max(rate.floor)).sum::<f64>();
            }
        }
        let highest = found.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        found.iter().position(|found| *found >= highest - NEAR_TIE_NATS).unwrap_or(0)
    }
}
