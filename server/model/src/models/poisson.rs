//! The Poisson-spectral model of counts: the expected number of events in an interval, with a periodic rate.
//!
//! The method is from Jovan et al., "A Poisson-Spectral Model for Modelling the Spatio-Temporal Patterns in Human
//! Data", IROS 2016: counts per interval are Poisson with a rate under a Gamma prior, and the rate is a mean and its
//! strongest periodic components. Invariant: the rate is positive and finite.

use super::mean::check_values;
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::{Component, InvalidParts, LocalDay, ORDER_MAX, Periodicities, StopSignal};

mod count_rate;
mod spectrum;
pub use count_rate::{CountRate, CountRateParts};
use spectrum::{Bin, Spectrum};

#[cfg(test)]
mod tests;

/// The interval that counts are summed over by default: ten minutes, in nanoseconds.
pub const COUNT_BIN_NANOS: i64 = 600 * 1_000_000_000;

/// Bins from a second to 400 days.
const BIN_NANOS_RANGE: std::ops::RangeInclusive<i64> = 1_000_000_000..=400 * 86_400 * 1_000_000_000;
/// The Gamma prior of the rate: half an event …
const PRIOR_EVENTS: f64 = 0.5;
/// … in one bin.
const PRIOR_BINS: f64 = 1.0;
/// The maximum count of a bin.
const COUNT_MAX: f64 = 1e12;
/// A lower order is preferred if its log-likelihood is within this of the highest: ln 20. The strongest of many
/// candidates often gain a nat or two on held-out days by noise alone.
const NEAR_TIE_NATS: f64 = 3.0;
/// With fewer days no days are held out.
const DAYS_MIN: usize = 4;

/// Events per bin as a mean and periodic components.
#[derive(Clone, Debug, PartialEq)]
pub struct PoissonSpectral {
    periodicities: Periodicities,
    parts: PoissonSpectralParts,
}

/// The parts of a [`PoissonSpectral`], for storage; the caller stores the periodicities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoissonSpectralParts {
    /// Length of a bin in nanoseconds, a second to 400 days.
    pub bin_nanos: i64,
    /// Mean count of a bin, above 0.
    pub mean: f64,
    /// The lower bound of the rate, in counts of a bin; above 0.
    pub floor: f64,
    /// The components in use, strongest first, at most [`ORDER_MAX`], in counts of a bin.
    pub components: Vec<Component>,
}

impl PoissonSpectral {
    /// Trains on counts. The values of all readings in a bin are added up; a bin without a reading counts as unobserved
    /// (so a counter that detects nobody must report 0). Bins are of local civil time, from 1970.
    ///
    /// The mean is that of the Gamma posterior, (½ + Σ counts)/(1 + bins), so that a count that was always 0 has a
    /// small positive rate. The rate is at least ½/(1 + days), the rate of a time of day without any count, but this
    /// floor is at most the mean. The order, 0..=[`ORDER_MAX`], is the one with the highest Poisson log-likelihood on
    /// the last quarter of the days, when trained on those before, or the lowest that is at most 20 times less likely;
    /// with fewer than four days it is 0.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, a value is not in 0..=1e12, or the bin is outside its range.
    pub fn train(
        readings: Readings<'_>,
        periodicities: &Periodicities,
        bin_nanos: i64,
    ) -> Result<PoissonSpectral, CannotTrain> {
        if !BIN_NANOS_RANGE.contains(&bin_nanos) {
            let (parameter, found) = ("bin in seconds", bin_nanos as f64 / 1e9);
            return Err(CannotTrain::Parameter { parameter, found, expected: "1 s to 400 days" });
        }
        check_values(readings, 0.0..=COUNT_MAX, "a count, 0 to 1e12")?;
        let bins = binned(readings, bin_nanos);
        let order = best_order(&bins, periodicities, bin_nanos, readings.stop);
        let model = PoissonSpectral::of_bins(&bins, periodicities, bin_nanos, order, readings.stop);
        readings.stop.check()?;
        Ok(model)
    }

    /// The model of the given order.
    fn of_bins(
        bins: &[Bin],
        periodicities: &Periodicities,
        bin_nanos: i64,
        order: usize,
        stop: StopSignal<'_>,
    ) -> PoissonSpectral {
        let weight: f64 = bins.iter().map(|bin| bin.weight).sum();
        let events: f64 = bins.iter().map(|bin| bin.weight * bin.count).sum();
        let mean = (PRIOR_EVENTS + events) / (PRIOR_BINS + weight);
        let days = day_runs(bins).count() as f64;
        let floor = (PRIOR_EVENTS / (PRIOR_BINS + days)).min(mean);
        let mut components = Spectrum::of(bins, periodicities, stop).strongest();
        components.truncate(order);
        PoissonSpectral {
            periodicities: periodicities.clone(),
            parts: PoissonSpectralParts { bin_nanos, mean, floor, components },
        }
    }

    /// The expected count of a bin by the first `order` components.
    fn count(&self, order: usize, civil_nanos: i64) -> f64 {
        let mut count = self.parts.mean;
        for component in self.parts.components.iter().take(order) {
            if let Some(turns) = self.periodicities.turns(component.periodicity as usize, civil_nanos) {
                let (sin, cos) = libm::sincos(std::f64::consts::TAU * turns);
                count += 2.0 * (component.gamma_re * cos - component.gamma_im * sin);
            }
        }
        count.max(self.parts.floor)
    }

    /// Number of components in use, 0..=[`ORDER_MAX`].
    pub fn order(&self) -> usize {
        self.parts.components.len()
    }

    /// Length of a bin in nanoseconds.
    pub fn bin_nanos(&self) -> i64 {
        self.parts.bin_nanos
    }

    /// The parts to store.
    pub fn to_parts(&self) -> PoissonSpectralParts {
        self.parts.clone()
    }

    /// A model from stored parts and the periodicities that it was trained with.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range or there are too many components.
    pub fn from_parts(
        periodicities: &Periodicities,
        parts: PoissonSpectralParts,
    ) -> Result<PoissonSpectral, InvalidParts> {
        let (shortest, longest) = (*BIN_NANOS_RANGE.start() as f64, *BIN_NANOS_RANGE.end() as f64);
        InvalidParts::check("bin", parts.bin_nanos as f64, shortest..=longest)?;
        InvalidParts::check("mean count", parts.mean, f64::MIN_POSITIVE..=f64::MAX)?;
        InvalidParts::check("least count", parts.floor, f64::MIN_POSITIVE..=parts.mean)?;
        if parts.components.len() > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: parts.components.len() });
        }
        for component in &parts.components {
            // The magnitude of γ is at most twice the mean of the counts, and this mean at most twice the posterior's.
            // The limit leaves room for rounding.
            let max_amplitude = 4.0 * parts.mean + 1.0;
            InvalidParts::check(
                "component index",
                f64::from(component.periodicity),
                0.0..=periodicities.len() as f64 - 1.0,
            )?;
            InvalidParts::check("gamma_re", component.gamma_re, -max_amplitude..=max_amplitude)?;
            InvalidParts::check("gamma_im", component.gamma_im, -max_amplitude..=max_amplitude)?;
        }
        Ok(PoissonSpectral { periodicities: periodicities.clone(), parts })
    }
}

impl TemporalModel for PoissonSpectral {
    /// The expected count of the bin around a moment; above 0.
    fn predict(&self, at: Moment) -> f64 {
        self.count(ORDER_MAX, at.civil_nanos())
    }
}

/// The observed bins, ascending.
fn binned(readings: Readings<'_>, bin_nanos: i64) -> Vec<Bin> {
    let mut bins = std::collections::BTreeMap::<i64, Bin>::new();
    for (sample, weight) in readings.samples.iter().zip(readings.weights()) {
        let index = sample.civil_nanos().div_euclid(bin_nanos);
        let centre_nanos = index.saturating_mul(bin_nanos).saturating_add(bin_nanos / 2);
        let bin = bins.entry(index).or_insert(Bin { centre_nanos, count: 0.0, weight });
        bin.count = (bin.count + sample.value).min(COUNT_MAX);
        bin.weight = weight;
    }
    bins.into_values().collect()
}

/// Runs of bins of the same local day.
fn day_runs(bins: &[Bin]) -> impl Iterator<Item = &[Bin]> {
    let day = |bin: &Bin| LocalDay::of_civil_nanos(bin.centre_nanos);
    bins.chunk_by(move |a, b| day(a) == day(b))
}

/// The order that predicts the last quarter of the days best from those before; on a near tie the lowest.
fn best_order(bins: &[Bin], periodicities: &Periodicities, bin_nanos: i64, stop: StopSignal<'_>) -> usize {
    let days: Vec<&[Bin]> = day_runs(bins).collect();
    if days.len() < DAYS_MIN {
        return 0;
    }
    let held_out = days[days.len() - days.len() / 4..].iter().map(|day| day.len()).sum::<usize>();
    let (learnt, held_out) = bins.split_at(bins.len() - held_out);
    let model = PoissonSpectral::of_bins(learnt, periodicities, bin_nanos, ORDER_MAX, stop);
    let log_likelihood = |order: usize| -> f64 {
        let of_bin = |bin: &Bin| {
            let expected = model.count(order, bin.centre_nanos);
            // The term ln(count!) is omitted, because it is equal for every order.
            bin.count * libm::log(expected) - expected
        };
        held_out.iter().map(of_bin).sum()
    };
    let found: Vec<f64> = (0..=model.order()).take_while(|_| !stop.is_set()).map(log_likelihood).collect();
    let highest = found.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    found.iter().position(|&found| found >= highest - NEAR_TIE_NATS).unwrap_or(0)
}
