//! Means of half-hour bins by hour: of all history by hour of the week, and of the last days by hour of weekdays or the
//! weekend.
//!
//! A table has levels, each shrunk towards the one before, which counts as three bins: the mean, the hour of the day,
//! the hour of the kind of day, the hour of the weekday. Invariant: sums are finite; tables fade by whole days.

use super::super::bins::{DayBins, SLOTS};
use crate::hours_seen::{HOURS, kind_of_day};

/// The days after which a bin counts half in the tables that forget.
pub(super) const HALF_LIVES_DAYS: [f64; RECENT] = [21.0, 7.0, 2.0];
/// Number of tables that forget.
pub(super) const RECENT: usize = 3;
/// The coarser level counts as this many bins.
const COARSER_BINS: f64 = 3.0;

/// Sums and numbers of bins by hour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cells {
    pub(super) sums: [f64; HOURS],
    pub(super) bins: [f64; HOURS],
}

const EMPTY: Cells = Cells { sums: [0.0; HOURS], bins: [0.0; HOURS] };

impl Cells {
    fn and(mut self, other: &Cells) -> Cells {
        self.sums.iter_mut().zip(&other.sums).for_each(|(sum, more)| *sum += more);
        self.bins.iter_mut().zip(&other.bins).for_each(|(bins, more)| *bins += more);
        self
    }

    fn scale(&mut self, factor: f64) {
        self.sums.iter_mut().chain(&mut self.bins).for_each(|number| *number *= factor);
    }

    fn add(&mut self, bins: &DayBins, weight: f64) {
        for (slot, value) in bins.seen() {
            self.sums[slot / 2] += weight * value;
            self.bins[slot / 2] += weight;
        }
    }

    fn mean(&self) -> f64 {
        let bins: f64 = self.bins.iter().sum();
        if bins > 0.0 { self.sums.iter().sum::<f64>() / bins } else { 0.0 }
    }

    /// The mean of each hour, shrunk towards a coarser level.
    fn level(&self, coarser: &[f64; HOURS]) -> [f64; HOURS] {
        let mut level = *coarser;
        for (value, (sum, bins)) in level.iter_mut().zip(self.sums.iter().zip(&self.bins)) {
            *value = (sum + COARSER_BINS * *value) / (bins + COARSER_BINS);
        }
        level
    }
}

/// The values of the tables on a weekday by half-hour, less the mean of each table: the shape of the day without its
/// level.
#[derive(Clone, Debug)]
pub(super) struct Shapes {
    /// The shape by hour of the day, of all history.
    pub(super) hour: [f64; SLOTS],
    /// The shape by hour of weekdays or the weekend, of all history.
    pub(super) kind: [f64; SLOTS],
    /// The shape by hour of the weekday, of all history.
    pub(super) weekday: [f64; SLOTS],
    /// The shapes of the tables that forget, by hour of weekdays or the weekend.
    pub(super) recent: [[f64; SLOTS]; RECENT],
}

/// The means of the tables: of the one of all history, then of those that forget.
pub(super) type Levels = [f64; RECENT + 1];

/// The tables of one state.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tables {
    /// The sums of all history, by weekday from Monday.
    pub(super) week: [Cells; 7],
    /// The sums of the tables that forget: of weekdays, then of the weekend.
    pub(super) recent: [[Cells; 2]; RECENT],
}

/// Values by hour as values by half-hour, with straight lines between the middles of hours. `less` is subtracted.
fn by_half_hour(hours: &[f64; HOURS], less: f64) -> [f64; SLOTS] {
    let mut slots = [0.0; SLOTS];
    for (slot, value) in slots.iter_mut().enumerate() {
        let hour = slot / 2;
        let beside = if slot % 2 == 0 { (hour + HOURS - 1) % HOURS } else { (hour + 1) % HOURS };
        *value = 0.75 * hours[hour] + 0.25 * hours[beside] - less;
    }
    slots
}

fn together(cells: &[Cells]) -> Cells {
    cells.iter().fold(EMPTY, |all, cells| all.and(cells))
}

impl Tables {
    pub(super) const fn new() -> Tables {
        Tables { week: [EMPTY; 7], recent: [[EMPTY; 2]; RECENT] }
    }

    /// The means of the tables.
    pub(super) fn levels(&self) -> Levels {
        let [slow, middle, fast] = self.recent.each_ref().map(|kinds| together(kinds).mean());
        [together(&self.week).mean(), slow, middle, fast]
    }

    /// The shapes of a weekday.
    pub(super) fn shapes(&self, weekday: usize) -> Shapes {
        let kind = kind_of_day(weekday);
        let all = together(&self.week);
        let of_kind = together(if kind == 0 { &self.week[..5] } else { &self.week[5..] });
        let mean = all.mean();
        let hour = all.level(&[mean; HOURS]);
        let by_kind = of_kind.level(&hour);
        let weekday = self.week[weekday].level(&by_kind);
        let recent = self.recent.each_ref().map(|kinds| {
            let all = together(kinds);
            let mean = all.mean();
            by_half_hour(&kinds[kind].level(&all.level(&[mean; HOURS])), mean)
        });
        Shapes {
            hour: by_half_hour(&hour, mean),
            kind: by_half_hour(&by_kind, mean),
            weekday: by_half_hour(&weekday, mean),
            recent,
        }
    }

    /// Ages the tables by days without bins.
    pub(super) fn pass(&mut self, days: f64) {
        for (kinds, half_life_days) in self.recent.iter_mut().zip(HALF_LIVES_DAYS) {
            kinds.iter_mut().for_each(|cells| cells.scale(libm::exp2(-days / half_life_days)));
        }
    }

    /// Adds a day. `is_next`: the day is newer than all learned days, which fade; else it is `age_days` older than the
    /// newest.
    pub(super) fn add(&mut self, weekday: usize, bins: &DayBins, is_next: bool, age_days: f64) {
        if is_next {
            self.pass(1.0);
        }
        self.week[weekday].add(bins, 1.0);
        for (kinds, half_life_days) in self.recent.iter_mut().zip(HALF_LIVES_DAYS) {
            kinds[kind_of_day(weekday)].add(bins, libm::exp2(-age_days / half_life_days));
        }
    }
}
