//! A histogram over the day or the week: each bin of the cycle has the mean of the readings in it.
//!
//! The model is Hist_n of RA-L 2019, section IV ("divides each day into n intervals and predicts the given variable as
//! an average in a relevant time of a day"), over local civil time. Invariant: every prediction is finite and lies
//! between the lowest and the highest reading.

use super::mean::{RunningMean, check_values};
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::InvalidParts;
use crate::special::square;

mod answer;
mod cycle;
mod hours;
mod narrow;

pub use cycle::HistogramCycle;
pub(crate) use hours::hour_runs;
pub use hours::{HourSpread, HourTable, HourTableParts};

#[cfg(test)]
mod tests;

/// The default weight of the overall mean in every bin, in readings.
pub const HISTOGRAM_PRIOR_READINGS: f64 = 1.0;

/// The settings of a [`Histogram`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistogramSettings {
    /// The cycle.
    pub cycle: HistogramCycle,
    /// Number of bins of the cycle, 1 to [`HistogramCycle::max_bins`]; for weekday and weekend, of each of the two
    /// days.
    pub bins: usize,
    /// Standard deviation of the circular Gaussian kernel that bins are smoothed with, in bins, 0 (none) to a quarter
    /// of `bins`. Bins of a weekday and of a weekend day are never mixed.
    pub smoothing_bins: f64,
    /// The weight of the overall mean in every bin, in readings, 0 to 1e9: bins with little data shrink towards it.
    pub prior_readings: f64,
}

impl HistogramSettings {
    /// The settings with no smoothing and the prior [`HISTOGRAM_PRIOR_READINGS`].
    pub fn new(cycle: HistogramCycle, bins: usize) -> HistogramSettings {
        HistogramSettings { cycle, bins, smoothing_bins: 0.0, prior_readings: HISTOGRAM_PRIOR_READINGS }
    }

    fn check(&self) -> Result<(), CannotTrain> {
        if !(1..=self.cycle.max_bins()).contains(&self.bins) {
            let expected = match self.cycle {
                HistogramCycle::Day | HistogramCycle::WeekdayWeekend => "1 to 1440 bins of the day",
                HistogramCycle::Week => "1 to 10080 bins of the week",
            };
            return Err(CannotTrain::Parameter { parameter: "bins", found: self.bins as f64, expected });
        }
        let found = self.smoothing_bins;
        if !(0.0..=self.bins as f64 / 4.0).contains(&found) {
            let expected = "0 to a quarter of the bins";
            return Err(CannotTrain::Parameter { parameter: "smoothing width in bins", found, expected });
        }
        let found = self.prior_readings;
        if !(0.0..=1e9).contains(&found) {
            return Err(CannotTrain::Parameter { parameter: "prior readings", found, expected: "0 to 1e9" });
        }
        Ok(())
    }
}

/// The mean value of each interval of a cycle (RA-L 2019, section IV).
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    parts: HistogramParts,
}

/// The parts of a [`Histogram`], for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct HistogramParts {
    /// The cycle.
    pub cycle: HistogramCycle,
    /// The prediction of each bin in order of time; for weekday and weekend first the weekday's bins, then the
    /// weekend's.
    pub values: Vec<f64>,
    /// The weight of the readings in each bin, before smoothing; as long as `values`.
    pub weights: Vec<f64>,
}

impl Histogram {
    /// Trains the mean of the readings in each bin, shrunk towards the mean of all: (Σwv + κμ)/(Σw + κ) with κ =
    /// `prior_readings`. A bin without readings has the prediction of the next coarser histogram with bins of that
    /// length that has readings there: after the week, weekday and weekend, then the day. If there is none, it predicts
    /// the mean of all.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, a value is not finite, or a setting is outside its range.
    pub fn train(readings: Readings<'_>, settings: &HistogramSettings) -> Result<Histogram, CannotTrain> {
        settings.check()?;
        check_values(readings, f64::MIN..=f64::MAX, "a finite number")?;
        let mut bins = vec![RunningMean::default(); settings.cycle.runs() * settings.bins];
        let mut all = RunningMean::default();
        for (sample, weight) in readings.samples.iter().zip(readings.weights()) {
            all.add(sample.value, weight);
            bins[settings.cycle.bin(settings.bins, sample.civil_nanos())].add(sample.value, weight);
        }
        let bins: Vec<(f64, f64)> = bins.iter().map(|bin| (bin.weight, bin.mean)).collect();
        let coarser = |bin: usize| {
            let mut sets = coarser_bins(settings.cycle, settings.bins, bin).into_iter();
            sets.find_map(|alike| {
                let mut mean = RunningMean::default();
                let (weights, values): (Vec<f64>, Vec<f64>) = alike.iter().map(|&bin| bins[bin]).unzip();
                weights.iter().zip(values).filter(|(weight, _)| **weight > 0.0).for_each(|(&w, v)| mean.add(v, w));
                (mean.weight > 0.0).then_some((mean.weight, mean.mean))
            })
        };
        Ok(Histogram::of_bins(settings, &bins, all.mean, coarser))
    }

    /// Builds the histogram from the weight and mean value of each bin, the mean of all readings, and the weight and
    /// mean value that a coarser histogram has in a bin.
    fn of_bins(
        settings: &HistogramSettings,
        bins: &[(f64, f64)],
        mean: f64,
        coarser: impl Fn(usize) -> Option<(f64, f64)>,
    ) -> Histogram {
        let smoothed = match settings.smoothing_bins {
            width if width > 0.0 => smoothed(bins, settings.bins, width),
            _ => bins.to_vec(),
        };
        let filled = |(bin, &own): (usize, &(f64, f64))| if own.0 > 0.0 { own } else { coarser(bin).unwrap_or(own) };
        let values = smoothed.iter().enumerate().map(filled);
        let values = values.map(|bin| shrunk(bin, mean, settings.prior_readings)).collect();
        let weights = bins.iter().map(|&(weight, _)| weight).collect();
        Histogram { parts: HistogramParts { cycle: settings.cycle, values, weights } }
    }

    /// The cycle.
    pub fn cycle(&self) -> HistogramCycle {
        self.parts.cycle
    }

    /// Number of bins of the cycle; for weekday and weekend, of each of the two days.
    pub fn bins(&self) -> usize {
        self.parts.values.len() / self.parts.cycle.runs()
    }

    /// Whether the histogram or a coarser one has readings in the bin of a moment. If not, it predicts the mean of all.
    pub fn has_readings_near(&self, at: Moment) -> bool {
        let bin = self.bin(at);
        let has = |bin: usize| self.parts.weights.get(bin).is_some_and(|&weight| weight > 0.0);
        has(bin) || coarser_bins(self.parts.cycle, self.bins(), bin).into_iter().flatten().any(has)
    }

    /// The weight of the readings in the bin of a moment.
    pub fn weight(&self, at: Moment) -> f64 {
        self.parts.weights.get(self.bin(at)).copied().unwrap_or(0.0)
    }

    fn bin(&self, at: Moment) -> usize {
        self.parts.cycle.bin(self.bins(), at.civil_nanos())
    }

    /// The parts to store.
    pub fn to_parts(&self) -> HistogramParts {
        self.parts.clone()
    }

    /// A model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where the number of bins does not fit the cycle or a number is outside its range.
    pub fn from_parts(parts: HistogramParts) -> Result<Histogram, InvalidParts> {
        let (runs, found) = (parts.cycle.runs(), parts.values.len());
        if found == 0 || found % runs != 0 || found / runs > parts.cycle.max_bins() {
            return Err(InvalidParts::OutOfRange { field: "number of bins", found: found as f64 });
        }
        if parts.weights.len() != found {
            return Err(InvalidParts::OutOfRange { field: "number of weights", found: parts.weights.len() as f64 });
        }
        for (&value, &weight) in parts.values.iter().zip(&parts.weights) {
            InvalidParts::check("bin value", value, f64::MIN..=f64::MAX)?;
            InvalidParts::check("bin weight", weight, 0.0..=f64::MAX)?;
        }
        Ok(Histogram { parts })
    }
}

impl TemporalModel for Histogram {
    fn predict(&self, at: Moment) -> f64 {
        self.parts.values[self.bin(at)]
    }
}

/// The bins that each coarser histogram with bins of equal length combines, the next coarser first.
fn coarser_bins(cycle: HistogramCycle, bins: usize, bin: usize) -> Vec<Vec<usize>> {
    match cycle {
        HistogramCycle::Day => Vec::new(),
        HistogramCycle::WeekdayWeekend => vec![vec![bin % bins, bins + bin % bins]],
        HistogramCycle::Week if bins.is_multiple_of(7) => {
            let of_day = bins / 7;
            let same = |days: std::ops::Range<usize>| days.map(|day| day * of_day + bin % of_day).collect();
            let alike = if bin / of_day >= 5 { 5..7 } else { 0..5 };
            vec![same(alike), same(0..7)]
        }
        HistogramCycle::Week => Vec::new(),
    }
}

/// The prediction of a bin with this weight and mean value, shrunk towards the mean of all.
fn shrunk((weight, value): (f64, f64), mean: f64, prior_readings: f64) -> f64 {
    if weight <= 0.0 {
        return mean;
    }
    let total = weight + prior_readings;
    let between = value * (weight / total) + mean * (prior_readings / total);
    // Rounding must not move the result outside the range of the readings.
    between.clamp(value.min(mean), value.max(mean))
}

/// Each bin's weight and mean over its neighbours, within runs of `run` bins that close into a circle: the
/// kernel-weighted mean of the readings (Nadaraya and Watson).
fn smoothed(bins: &[(f64, f64)], run: usize, width_bins: f64) -> Vec<(f64, f64)> {
    // Beyond four standard deviations a kernel has 6e-5 of its mass; beyond half the circle it would count bins twice.
    let reach = ((4.0 * width_bins).ceil() as usize).min((run - 1) / 2);
    let kernel: Vec<f64> = (0..=reach).map(|bin| libm::exp(-0.5 * square(bin as f64 / width_bins))).collect();
    let mut smoothed = Vec::with_capacity(bins.len());
    for circle in bins.chunks(run) {
        for at in 0..circle.len() {
            let mut mean = RunningMean::default();
            let mut add = |bin: usize, factor: f64| {
                let (weight, value) = circle[bin % circle.len()];
                if weight * factor > 0.0 {
                    mean.add(value, weight * factor);
                }
            };
            add(at, kernel[0]);
            for (distance, &factor) in kernel.iter().enumerate().skip(1) {
                add(at + distance, factor);
                add(at + circle.len() - distance, factor);
            }
            smoothed.push((mean.weight, mean.mean));
        }
    }
    smoothed
}
