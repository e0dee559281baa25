//! Readings summed per day of the week and slot of ten minutes, over days.
//!
//! A day counts once in a slot, whatever its number of readings there: readings minutes apart repeat each other.
//! Invariant: values are scaled to `[0,1]`, so every mean lies there.

use super::options::CalibratedOptions;
use crate::civil::NANOS_PER_SEC;
use crate::models::Readings;
use crate::special::square;
use crate::{LocalDay, Sample};

/// The day of the week: Monday 0 to Sunday 6.
pub(super) fn day_of_week(day: LocalDay) -> usize {
    // 1970-01-01 was a Thursday.
    (i64::from(day.0) + 3).rem_euclid(DAYS_OF_WEEK as i64) as usize
}

/// Slots of ten minutes in a day.
pub(super) const SLOTS_PER_DAY: usize = 144;
pub(super) const DAYS_OF_WEEK: usize = 7;
const SECS_PER_SLOT: f64 = 86_400.0 / SLOTS_PER_DAY as f64;

/// Sums over the days of one slot: a day's value x there, its weight w, and the observed share c of the slot's
/// neighbourhood, in `(0,1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct DaySums {
    /// Σ w c over days.
    weight: f64,
    /// Σ (w c)².
    weight_squared: f64,
    /// Σ w² c.
    seen: f64,
    /// Σ w c x.
    value: f64,
    /// Σ w c x².
    value_squared: f64,
}

impl DaySums {
    fn add(&mut self, weight: f64, seen: f64, value: f64) {
        let counts = weight * seen;
        self.weight += counts;
        self.weight_squared += counts * counts;
        self.seen += weight * counts;
        self.value += counts * value;
        self.value_squared += counts * value * value;
    }

    /// Adds the sums over the days of both.
    pub(super) fn and(self, other: DaySums) -> DaySums {
        DaySums {
            weight: self.weight + other.weight,
            weight_squared: self.weight_squared + other.weight_squared,
            seen: self.seen + other.seen,
            value: self.value + other.value,
            value_squared: self.value_squared + other.value_squared,
        }
    }

    /// The equivalent number of fully observed days of equal weight: (Σ w c)²/Σ w² c, 0 without days.
    pub(super) fn days(self) -> f64 {
        if self.weight > 0.0 { self.weight * self.weight / self.seen } else { 0.0 }
    }

    /// The mean observed share of a day, in `[0,1]`.
    pub(super) fn share_seen(self) -> f64 {
        if self.weight > 0.0 { self.weight_squared / self.seen } else { 0.0 }
    }

    /// Weighted mean over days; 0 without days.
    pub(super) fn mean(self) -> f64 {
        if self.weight > 0.0 { (self.value / self.weight).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Sum of squared deviations from the mean over days, for [`DaySums::days`] days.
    pub(super) fn deviations(self) -> f64 {
        if self.weight > 0.0 {
            let mean = self.value / self.weight;
            self.days() * (self.value_squared / self.weight - mean * mean).max(0.0)
        } else {
            0.0
        }
    }

    /// The degrees of freedom of [`DaySums::deviations`].
    pub(super) fn freedom(self) -> f64 {
        (self.days() - self.share_seen()).max(0.0)
    }
}

/// The sums of one slot of the day, per day of the week, Monday first.
pub(super) type WeekSums = [DaySums; DAYS_OF_WEEK];

/// The sums of all slots of the day.
pub(super) struct SlotSums {
    /// Each day, lightly smoothed.
    pub(super) fine: Vec<WeekSums>,
    /// Each day, broadly smoothed.
    pub(super) broad: Vec<WeekSums>,
}

impl SlotSums {
    /// Computes the sums over days; the newest day has the date `newest`.
    pub(super) fn of(days: impl Iterator<Item = SlotDay>, newest: i32, options: CalibratedOptions) -> SlotSums {
        let empty = || vec![WeekSums::default(); SLOTS_PER_DAY];
        let mut sums = SlotSums { fine: empty(), broad: empty() };
        let (fine, broad) = (Kernel::new(options.smoothing_secs), Kernel::new(options.broad_smoothing_secs));
        for day in days {
            let age_days = f64::from(newest.abs_diff(day.date.0));
            let weight = day.weight / (1.0 + age_days / options.memory_days);
            fine.smooth(&day.means, |slot, seen, value| sums.fine[slot][day.of_week].add(weight, seen, value));
            broad.smooth(&day.means, |slot, seen, value| sums.broad[slot][day.of_week].add(weight, seen, value));
        }
        sums
    }
}

/// One local day.
pub(super) struct SlotDay {
    pub(super) date: LocalDay,
    /// The day of the week, Monday 0 to Sunday 6.
    pub(super) of_week: usize,
    /// The mean weight of the day's readings, in `(0,1]`.
    pub(super) weight: f64,
    /// The mean value in each observed slot.
    pub(super) means: [Option<f64>; SLOTS_PER_DAY],
}

/// The days of the readings, ascending; `to_unit` scales values to `[0,1]`. Where clocks are set back over midnight a
/// date may come in two pieces.
pub(super) fn days<'a>(
    readings: Readings<'a>,
    to_unit: impl Fn(f64) -> f64 + 'a,
) -> impl Iterator<Item = SlotDay> + 'a {
    let mut weights = readings.weights();
    readings.samples.chunk_by(|a, b| a.local_day() == b.local_day()).map(move |of_day| {
        let date = of_day[0].local_day();
        let mut slots = [(0.0, 0.0); SLOTS_PER_DAY];
        let mut day_weight = 0.0;
        for (sample, weight) in of_day.iter().zip(&mut weights) {
            // The weight is not too small, because squares would underflow.
            let weight = f64::max(weight, 1e-100);
            if !sample.value.is_finite() {
                continue;
            }
            let (weight_sum, value_sum) = &mut slots[slot_of(sample)];
            *weight_sum += weight;
            *value_sum += weight * to_unit(sample.value);
            day_weight += weight;
        }
        let means = slots.map(|(weight, value)| (weight > 0.0).then(|| value / weight));
        SlotDay { date, of_week: day_of_week(date), weight: day_weight / of_day.len() as f64, means }
    })
}

fn slot_of(sample: &Sample) -> usize {
    let secs = sample.civil_nanos().div_euclid(NANOS_PER_SEC).rem_euclid(86_400);
    secs as usize * SLOTS_PER_DAY / 86_400
}

/// A Gaussian over slots, cut off at three standard deviations and at the ends of the day.
struct Kernel {
    /// The weights from one end of the kernel to the other; its centre is in the middle.
    weights: Vec<f64>,
    /// For each slot, the sum of the weights that lie within the day.
    within: [f64; SLOTS_PER_DAY],
}

impl Kernel {
    fn new(deviation_secs: f64) -> Kernel {
        let deviation = deviation_secs / SECS_PER_SLOT;
        let reach = ((3.0 * deviation).ceil() as usize).min(SLOTS_PER_DAY - 1);
        let weight = |slots: usize| if slots == 0 { 1.0 } else { libm::exp(-0.5 * square(slots as f64 / deviation)) };
        let weights: Vec<f64> = (0..=2 * reach).map(|place| weight(place.abs_diff(reach))).collect();
        let mut kernel = Kernel { weights, within: [0.0; SLOTS_PER_DAY] };
        kernel.within = kernel.over(&[1.0; SLOTS_PER_DAY]);
        kernel
    }

    /// For each slot the weighted sum of the numbers around it. The loop takes the weights one by one over all slots,
    /// so that it vectorises over slots.
    fn over(&self, numbers: &[f64; SLOTS_PER_DAY]) -> [f64; SLOTS_PER_DAY] {
        let reach = self.weights.len() / 2;
        let mut padded = [0.0; 3 * SLOTS_PER_DAY];
        padded[reach..reach + SLOTS_PER_DAY].copy_from_slice(numbers);
        let mut sums = [0.0; SLOTS_PER_DAY];
        for (&weight, around) in self.weights.iter().zip(padded.windows(SLOTS_PER_DAY)) {
            for (sum, number) in sums.iter_mut().zip(around) {
                *sum += weight * number;
            }
        }
        sums
    }

    /// Calls `each` with each slot's local mean and the observed share of its neighbourhood within the day, in `(0,1]`.
    fn smooth(&self, means: &[Option<f64>; SLOTS_PER_DAY], mut each: impl FnMut(usize, f64, f64)) {
        let seen = self.over(&means.map(|mean| f64::from(u8::from(mean.is_some()))));
        let value = self.over(&means.map(|mean| mean.unwrap_or(0.0)));
        for (slot, ((seen, value), within)) in seen.into_iter().zip(value).zip(self.within).enumerate() {
            if seen > 0.0 {
                each(slot, seen / within, value / seen);
            }
        }
    }
}
