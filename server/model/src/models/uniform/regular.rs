//! Whether readings are regular, and the interval between them.
//!
//! The interval is the mean of the differences of their times, which a single wrong nanosecond does not shift. It is
//! valid if every reading lies within 1 % of it from its regular time. Otherwise the error names the median of the
//! differences, which gaps do not shift, and the first reading that is too late or too early. Invariant: the interval
//! is above 0, and no reading is missing.

use super::{CannotTrain, Sample};

/// The maximum number of readings: steps are stored in 32 bits.
pub(super) const STEPS_MAX: u64 = u32::MAX as u64;

/// The tolerance of a reading's time, as a share of the interval.
const JITTER: f64 = 0.01;

/// The first sample and the interval in nanoseconds, if the samples are regular.
pub(super) fn regular(samples: &[Sample]) -> Result<(Sample, i64), CannotTrain> {
    let found = samples.len();
    let (&[first, .., last], 2..=STEPS_MAX) = (samples, found as u64) else {
        return Err(CannotTrain::Parameter {
            parameter: "number of readings",
            found: found as f64,
            expected: "2 to 4e9",
        });
    };
    let span_nanos = i128::from(last.utc_nanos) - i128::from(first.utc_nanos);
    let gaps = found as i128 - 1;
    // The interval is rounded, because an error of one nanosecond would add up over a million steps.
    let interval_nanos = i64::try_from((2 * span_nanos + gaps).div_euclid(2 * gaps)).unwrap_or(i64::MAX);
    let is_off = |(step, sample): (u32, &Sample)| off_time(sample, first.utc_nanos, interval_nanos, step);
    match (0..).zip(samples).position(is_off) {
        None if interval_nanos > 0 => Ok((first, interval_nanos)),
        off => Err(irregular(samples, off.unwrap_or(1))),
    }
}

/// Whether a sample is not at the time of its step.
pub(super) fn off_time(sample: &Sample, first_nanos: i64, interval_nanos: i64, step: u32) -> bool {
    let regular_nanos = i128::from(first_nanos) + i128::from(interval_nanos) * i128::from(step);
    let off_nanos = (i128::from(sample.utc_nanos) - regular_nanos).unsigned_abs();
    off_nanos as f64 > JITTER * interval_nanos as f64
}

/// The error for samples that are not regular. It names the first sample that does not come one usual interval after
/// the one before, or else the sample that has drifted off its time.
fn irregular(samples: &[Sample], drifted: usize) -> CannotTrain {
    let secs = |i: usize| match (samples.get(i), i.checked_sub(1).and_then(|before| samples.get(before))) {
        (Some(sample), Some(before)) => (i128::from(sample.utc_nanos) - i128::from(before.utc_nanos)) as f64 / 1e9,
        _ => 0.0,
    };
    let mut differences: Vec<f64> = (1..samples.len()).map(secs).collect();
    let middle = differences.len() / 2;
    let interval_secs = *differences.select_nth_unstable_by(middle, f64::total_cmp).1;
    let jumps = |&i: &usize| interval_secs <= 0.0 || (secs(i) - interval_secs).abs() > JITTER * interval_secs;
    let at = (1..samples.len()).find(jumps).unwrap_or(drifted);
    let at_secs = samples.get(at).map_or(0.0, |sample| sample.utc_nanos as f64 / 1e9);
    CannotTrain::Irregular { interval_secs, at_secs, after_secs: secs(at) }
}
