//! The prediction of a histogram in one hour, from the table of hours, without building the histogram.
//!
//! Invariant: a prediction is bit for bit that of the histogram of [`HourTable::histogram`].

use std::ops::Range;

use super::cycle::{DAY_HOURS, is_weekend};
use super::hours::{add_to, mean};
use super::{HISTOGRAM_PRIOR_READINGS, HistogramCycle, HourTable, shrunk};

/// Number of days of a week.
const WEEK_DAYS: usize = 7;
/// Number of weekdays, Monday to Friday.
const WEEKDAYS: usize = 5;

impl HourTable {
    /// The mean of all readings; `None` without readings.
    pub(crate) fn mean(&self) -> Option<f64> {
        let all = total(self.cells().iter());
        (all[0] > 0.0).then(|| mean(all))
    }

    /// The prediction of [`HourTable::histogram`] in an hour of the week, 0..168, and whether the histogram itself has
    /// readings in that hour. `None` if neither the histogram nor a coarser one has some. `mean_of_all` is
    /// [`HourTable::mean`]. `bins` must be valid for [`HourTable::histogram`].
    pub(crate) fn answer(
        &self,
        (cycle, bins): (HistogramCycle, usize),
        hour_of_week: usize,
        mean_of_all: f64,
    ) -> (Option<f64>, bool) {
        let per_bin = cycle.hours() / bins.max(1);
        let days = match cycle {
            HistogramCycle::Week => 0..1,
            HistogramCycle::Day => 0..WEEK_DAYS,
            HistogramCycle::WeekdayWeekend => alike(hour_of_week),
        };
        let hour = hour_of_week % cycle.hours();
        let first = hour - hour % per_bin.max(1);
        let own = self.over(days, first, per_bin);
        let has_own = own[0] > 0.0;
        let bin = if has_own { Some(own) } else { self.coarser(cycle, per_bin, hour_of_week) };
        let predicted = |bin: [f64; 2]| shrunk((bin[0], mean(bin)), mean_of_all, HISTOGRAM_PRIOR_READINGS);
        (bin.map(predicted), has_own)
    }

    /// The readings of the next coarser histogram that has some in the bin of `per_bin` hours of the given hour of the
    /// week: after the week, weekday and weekend, then the day.
    pub(super) fn coarser(&self, cycle: HistogramCycle, per_bin: usize, hour_of_week: usize) -> Option<[f64; 2]> {
        if per_bin == 0 || !DAY_HOURS.is_multiple_of(per_bin) {
            return None;
        }
        let hour = hour_of_week % DAY_HOURS;
        let first = hour - hour % per_bin;
        let found = |days: Range<usize>| Some(self.over(days, first, per_bin)).filter(|bin| bin[0] > 0.0);
        match cycle {
            HistogramCycle::Week => found(alike(hour_of_week)).or_else(|| found(0..WEEK_DAYS)),
            HistogramCycle::WeekdayWeekend => found(0..WEEK_DAYS),
            HistogramCycle::Day => None,
        }
    }

    /// The sum of the same hours of some days.
    fn over(&self, days: Range<usize>, first: usize, hours: usize) -> [f64; 2] {
        let hours = days.flat_map(|day| (0..hours).map(move |hour| day * DAY_HOURS + first + hour));
        total(hours.map(|hour| self.readings(hour)))
    }
}

/// The days of the week that have the same kind as the hour's day.
fn alike(hour_of_week: usize) -> Range<usize> {
    if is_weekend(hour_of_week) { WEEKDAYS..WEEK_DAYS } else { 0..WEEKDAYS }
}

/// The sum of cells, with the bounds of [`HourTable::histogram`].
fn total(cells: impl Iterator<Item = [f64; 2]> + Clone) -> [f64; 2] {
    // Without overflow the bounds change nothing, and an overflow never becomes finite again.
    let plain = cells.clone().fold([0.0; 2], |[weight, sum], cell| [weight + cell[0], sum + cell[1]]);
    if plain.iter().all(|sum| sum.is_finite()) {
        return plain;
    }
    let mut bounded = [0.0; 2];
    cells.for_each(|cell| add_to(&mut bounded, cell));
    bounded
}
