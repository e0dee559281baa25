//! Sums per hour of the week, from which histograms are computed without raw data.
//!
//! The table has 168 cells of the week and, for the variance between days, the means of single hours of single days. It
//! takes 0.5 kB for a state whose readings are 0 and 1, and at most 3.8 kB. Invariant: sums commute, so the table
//! depends neither on order nor on batching beyond 1e-9, as long as no local hour is split over two batches.

use super::cycle::{DAY_HOURS, HOUR_NANOS, WEEK_HOURS, civil_hour, hour_of_week_of, is_weekend};
use super::narrow::Narrow;
use super::{HISTOGRAM_PRIOR_READINGS, Histogram, HistogramCycle, HistogramSettings};
use crate::{InvalidParts, Sample};

/// Readings of the same local civil hour that follow each other.
pub(crate) struct HourRun<'a> {
    /// The hour's number, from 1970-01-01T00:00 local.
    pub(crate) civil_hour: i64,
    /// The readings, at least one.
    pub(crate) samples: &'a [Sample],
}

impl HourRun<'_> {
    /// The hour of the week, 0..168 from Monday, midnight.
    pub(crate) fn hour_of_week(&self) -> usize {
        hour_of_week_of(self.civil_hour)
    }
}

/// Runs of readings of the same hour, in the given order.
pub(crate) fn hour_runs(samples: &[Sample]) -> impl Iterator<Item = HourRun<'_>> {
    let mut rest = samples;
    std::iter::from_fn(move || {
        let civil_nanos = rest.first()?.civil_nanos();
        // One division per run, none per reading.
        let into = civil_nanos.rem_euclid(HOUR_NANOS);
        let hour = civil_nanos.saturating_sub(into)..=civil_nanos.saturating_add(HOUR_NANOS - 1 - into);
        let length = rest.iter().position(|sample| !hour.contains(&sample.civil_nanos()));
        let (samples, later) = rest.split_at(length.unwrap_or(rest.len()));
        rest = later;
        Some(HourRun { civil_hour: civil_hour(civil_nanos), samples })
    })
}

/// The first hour of Saturday.
const WEEKEND_HOUR: usize = 5 * DAY_HOURS;

/// Smaller weights count as 0: their sums have no precision left.
const WEIGHT_MIN: f64 = 1e-9;

/// The readings of each hour of the local week, and the variance between days in each hour of the day.
#[derive(Clone, Debug, PartialEq)]
pub struct HourTable {
    /// [`HourTableParts::cells`] in narrow numbers.
    cells: Narrow<2>,
    /// [`HourTableParts::days`] in narrow numbers.
    days: Narrow<3>,
}

/// The parts of an [`HourTable`], for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HourTableParts {
    /// 168 cells, one per hour of the local week from Monday, midnight: `[weight, Σ value]` of the readings.
    pub cells: Vec<[f64; 2]>,
    /// 48 cells, per hour of the local day first of weekdays, then of Saturday and Sunday: `[weight, Σ m, Σ m²]` of the
    /// means m of that hour on single days.
    pub days: Vec<[f64; 3]>,
}

impl HourTableParts {
    /// All numbers: those of `cells`, then those of `days`.
    pub fn numbers(&self) -> Vec<f64> {
        [self.cells.as_flattened(), self.days.as_flattened()].concat()
    }

    /// The parts of these numbers.
    ///
    /// # Errors
    /// [`InvalidParts`] where their number is not that of a table.
    pub fn of_numbers(numbers: &[f64]) -> Result<HourTableParts, InvalidParts> {
        let wrong = InvalidParts::OutOfRange { field: "numbers of the hours", found: numbers.len() as f64 };
        let (cells, days) = numbers.split_at_checked(2 * WEEK_HOURS).ok_or(wrong.clone())?;
        let ((cells, []), (days, [])) = (cells.as_chunks(), days.as_chunks()) else { return Err(wrong) };
        Ok(HourTableParts { cells: cells.to_vec(), days: days.to_vec() })
    }
}

/// The variation of the mean value of one hour of the day between days.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HourSpread {
    /// Number of days; fractional with forgetting.
    pub days: f64,
    /// The mean over days.
    pub mean: f64,
    /// The standard deviation over days, with n - 1; 0 with one day or less.
    pub standard_deviation: f64,
}

impl Default for HourTable {
    /// An empty table.
    fn default() -> HourTable {
        HourTable { cells: Narrow::zeros(WEEK_HOURS), days: Narrow::zeros(2 * DAY_HOURS) }
    }
}

impl HourTable {
    /// Adds readings in any order; those that are not finite are ignored.
    ///
    /// A local hour of one date that is split over two batches enters the cells of the week as usual, but counts as two
    /// days in [`HourTable::spread`]. The hour that comes twice when clocks are set back is one hour.
    pub fn add(&mut self, samples: &[Sample]) {
        // For each run: the hour, and the number and sum of the readings.
        let mut runs: Vec<(i64, f64, f64)> = Vec::with_capacity(DAY_HOURS + 1);
        runs.extend(hour_runs(samples).map(|run| {
            let values = run.samples.iter().map(|sample| sample.value).filter(|value| value.is_finite());
            let (number, sum) = values.fold((0.0, 0.0), |(number, sum), value| (number + 1.0, bounded(sum + value)));
            (run.civil_hour, number, sum)
        }));
        // The runs are usually in order already, and each hour is one run.
        runs.sort_by_key(|&(hour, ..)| hour);
        for of_hour in runs.chunk_by(|one, next| one.0 == next.0) {
            let hour = of_hour[0].0;
            let add = |(count, sum): (f64, f64), run: &(i64, f64, f64)| (count + run.1, bounded(sum + run.2));
            let (count, sum) = of_hour.iter().fold((0.0, 0.0), add);
            if count <= 0.0 {
                continue;
            }
            let hour_of_week = hour_of_week_of(hour);
            add_at(&mut self.cells, hour_of_week, [count, sum]);
            let mean = sum / count;
            let day = day_cell(hour_of_week % DAY_HOURS, is_weekend(hour_of_week));
            add_at(&mut self.days, day, [1.0, mean, mean * mean]);
        }
    }

    /// Adds the readings of another table.
    pub(crate) fn merge(&mut self, other: &HourTable) {
        other.cells.iter().enumerate().for_each(|(index, cell)| add_at(&mut self.cells, index, cell));
        other.days.iter().enumerate().for_each(|(index, cell)| add_at(&mut self.days, index, cell));
    }

    /// Multiplies the weight of all readings so far by `factor`, 0 to 1 (forgetting). Other factors count as the nearer
    /// end, and NaN changes nothing.
    pub fn scale(&mut self, factor: f64) {
        if factor.is_nan() {
            return;
        }
        let factor = factor.clamp(0.0, 1.0);
        self.cells.change(|cell| scale_by(cell, factor));
        self.days.change(|cell| scale_by(cell, factor));
    }

    /// The histogram with the default prior and no smoothing, equal to [`Histogram::train`] on these readings. `None`
    /// without readings, or if a bin would not hold whole hours: the number of bins must divide 168 for the week, and
    /// 24 for the other cycles.
    pub fn histogram(&self, cycle: HistogramCycle, bins: usize) -> Option<Histogram> {
        if bins == 0 || !cycle.hours().is_multiple_of(bins) {
            return None;
        }
        let per_bin = cycle.hours() / bins;
        let mut sums = vec![[0.0; 2]; cycle.runs() * bins];
        let mut all = [0.0; 2];
        for (hour_of_week, cell) in self.cells.iter().enumerate() {
            let bin = match cycle {
                HistogramCycle::Day => (hour_of_week % DAY_HOURS) / per_bin,
                HistogramCycle::Week => hour_of_week / per_bin,
                HistogramCycle::WeekdayWeekend => {
                    usize::from(is_weekend(hour_of_week)) * bins + (hour_of_week % DAY_HOURS) / per_bin
                }
            };
            add_to(&mut sums[bin], cell);
            add_to(&mut all, cell);
        }
        if all[0] <= 0.0 {
            return None;
        }
        let means: Vec<(f64, f64)> = sums.iter().map(|&bin| (bin[0], mean(bin))).collect();
        let coarser = |bin: usize| {
            let first_hour = match cycle {
                HistogramCycle::WeekdayWeekend if bin >= bins => WEEKEND_HOUR + (bin - bins) * per_bin,
                _ => bin * per_bin,
            };
            self.coarser(cycle, per_bin, first_hour).map(|bin| (bin[0], mean(bin)))
        };
        let settings =
            HistogramSettings { prior_readings: HISTOGRAM_PRIOR_READINGS, ..HistogramSettings::new(cycle, bins) };
        Some(Histogram::of_bins(&settings, &means, mean(all), coarser))
    }

    /// Weight and sum of the readings of an hour of the local week from Monday, midnight; zeros beyond 167.
    pub fn readings(&self, hour_of_week: usize) -> [f64; 2] {
        self.cells.get(hour_of_week).unwrap_or_default()
    }

    /// The weight of the readings of an hour of the local week, 0..168 from Monday, midnight; 0 for others.
    pub fn weight(&self, hour_of_week: usize) -> f64 {
        self.cells.get(hour_of_week).map_or(0.0, |cell| cell[0])
    }

    /// Number of single hours of single days with readings, faded by forgetting.
    pub fn observed_hours(&self) -> f64 {
        bounded(self.days.iter().map(|cell| cell[0]).sum())
    }

    /// The variation of an hour of the day, 0..24, between weekdays, or between days of weekends; `None` if it has no
    /// readings.
    pub fn spread(&self, hour_of_day: usize, weekend: bool) -> Option<HourSpread> {
        if hour_of_day >= DAY_HOURS {
            return None;
        }
        let [days, sum, squares] = self.days.get(day_cell(hour_of_day, weekend))?;
        if days <= 0.0 {
            return None;
        }
        let mean = bounded(sum / days);
        let variance = if days > 1.0 { (squares - sum * mean).max(0.0) / (days - 1.0) } else { 0.0 };
        Some(HourSpread { days, mean, standard_deviation: bounded(variance.sqrt()) })
    }

    /// The cells of the week.
    pub(super) fn cells(&self) -> &Narrow<2> {
        &self.cells
    }

    /// The parts to store.
    pub fn to_parts(&self) -> HourTableParts {
        HourTableParts { cells: self.cells.iter().collect(), days: self.days.iter().collect() }
    }

    /// A table from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where there are not 168 and 48 cells or a number is outside its range.
    pub fn from_parts(parts: &HourTableParts) -> Result<HourTable, InvalidParts> {
        for (field, found, expected) in [
            ("cells of the week", parts.cells.len(), WEEK_HOURS),
            ("cells of the days", parts.days.len(), 2 * DAY_HOURS),
        ] {
            if found != expected {
                return Err(InvalidParts::OutOfRange { field, found: found as f64 });
            }
        }
        for &[weight, sum] in &parts.cells {
            InvalidParts::check("weight of an hour", weight, 0.0..=f64::MAX)?;
            InvalidParts::check("sum of an hour", sum, f64::MIN..=f64::MAX)?;
        }
        for &[weight, sum, squares] in &parts.days {
            InvalidParts::check("weight of days", weight, 0.0..=f64::MAX)?;
            InvalidParts::check("sum over days", sum, f64::MIN..=f64::MAX)?;
            InvalidParts::check("sum of squares over days", squares, 0.0..=f64::MAX)?;
        }
        Ok(HourTable { cells: Narrow::of(&parts.cells), days: Narrow::of(&parts.days) })
    }
}

fn day_cell(hour_of_day: usize, weekend: bool) -> usize {
    usize::from(weekend) * DAY_HOURS + hour_of_day
}

/// The mean value of a cell; 0 without readings.
pub(super) fn mean([weight, sum]: [f64; 2]) -> f64 {
    if weight > 0.0 { bounded(sum / weight) } else { 0.0 }
}

pub(super) fn add_to<const N: usize>(cell: &mut [f64; N], other: [f64; N]) {
    for (sum, other) in cell.iter_mut().zip(other) {
        *sum = bounded(*sum + other);
    }
}

fn add_at<const N: usize>(cells: &mut Narrow<N>, index: usize, other: [f64; N]) {
    if let Some(mut cell) = cells.get(index) {
        add_to(&mut cell, other);
        cells.set(index, cell);
    }
}

fn scale_by<const N: usize>(cell: &mut [f64; N], factor: f64) {
    cell.iter_mut().for_each(|sum| *sum *= factor);
    if cell[0] < WEIGHT_MIN {
        *cell = [0.0; N];
    }
}

/// Bounds a sum, so that sums of huge values saturate instead of overflowing.
fn bounded(sum: f64) -> f64 {
    sum.clamp(f64::MIN, f64::MAX)
}
