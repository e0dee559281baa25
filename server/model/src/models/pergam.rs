//! Periodic Gaussian mixture: events at fixed times of the period, such as a day.
//!
//! The model is PerGaM of Krajník et al., "Where's Waldo at time t?", ICRA 2015 ("Waldo"), section IV.B: the readings
//! are folded into one period (eq. 6) and a mixture of Gaussians is trained on their mean values (eq. 7). The Gaussians
//! are wrapped here, so that 23:59 is next to 0:01. The model can represent several short events, but only one period,
//! which must be known. Invariant: at most [`PergamOptions::GAUSSIANS_MAX`], widths positive; a prediction lies in
//! `[0,1]`.

use super::mean::check_values;
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::InvalidParts;
use crate::civil::NANOS_PER_SEC;
use crate::fields::{FINITE, Packed, StoredFields, Visitor};

mod expectation;
mod phases;

use expectation::{WrappedGaussian, train_wrapped};
use phases::PhaseMeans;

#[cfg(test)]
mod tests;

const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;
/// A hundred years of 365.25 days.
const PERIOD_MAX_NANOS: i64 = 36_525 * DAY_NANOS;

/// The options of training a periodic Gaussian mixture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PergamOptions {
    /// Number of Gaussians, 1 to [`PergamOptions::GAUSSIANS_MAX`]; fewer where the readings have fewer distinct phases.
    pub gaussians: usize,
    /// The period, in nanoseconds of local civil time, from 1 s to 100 years.
    pub period_nanos: i64,
    /// Seed of the starting points of the training.
    pub seed: u64,
}

impl PergamOptions {
    /// The maximum number of Gaussians.
    pub const GAUSSIANS_MAX: usize = 20;
}

impl Default for PergamOptions {
    /// Three Gaussians over a day, the most that Waldo evaluates (section VII.A).
    fn default() -> PergamOptions {
        PergamOptions { gaussians: 3, period_nanos: DAY_NANOS, seed: 0 }
    }
}

/// One Gaussian of a [`Pergam`], in plain numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PergamGaussian {
    /// The mean contribution of the Gaussian to the probability over a period, in `[0,1]`: w_j/τ of Waldo eq. 7.
    pub weight: f64,
    /// The position of the Gaussian in the period, μ_j, in seconds from the start, from 0 to the period.
    pub mean_secs: f64,
    /// The width of the Gaussian, σ_j, in seconds; above 0, at most the period.
    pub deviation_secs: f64,
}

/// The parts of a [`Pergam`], for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PergamParts {
    /// The period τ, in nanoseconds.
    pub period_nanos: i64,
    /// The Gaussians; none if the state was never on.
    pub gaussians: Vec<PergamGaussian>,
}

/// Tag 1 belongs to the training.
impl StoredFields for PergamParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(2, "period of a mixture", &mut self.period_nanos)?;
        visitor.list(3, "Gaussians of a mixture", FINITE, &mut self.gaussians)
    }
}

impl Packed for PergamGaussian {
    const BYTES: usize = <[f64; 3]>::BYTES;

    fn put(&self, bytes: &mut Vec<u8>) {
        [self.weight, self.mean_secs, self.deviation_secs].put(bytes);
    }

    fn take(bytes: &[u8]) -> PergamGaussian {
        let [weight, mean_secs, deviation_secs] = Packed::take(bytes);
        PergamGaussian { weight, mean_secs, deviation_secs }
    }
}

/// A probability over a period, as a sum of wrapped Gaussians (Waldo eq. 7).
#[derive(Clone, Debug, PartialEq)]
pub struct Pergam {
    parts: PergamParts,
    /// The Gaussians of `parts`, with mean and deviation in turns.
    wrapped: Vec<WrappedGaussian>,
}

impl Pergam {
    /// Trains the mixture by expectation-maximisation and keeps the likeliest of several seeded starts. Phases have a
    /// resolution of a 1,440th of the period; a phase that was never observed is interpolated between its observed
    /// neighbours.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, or an option or a value is outside its range.
    pub fn train(readings: Readings<'_>, options: &PergamOptions) -> Result<Pergam, CannotTrain> {
        check_range("gaussians", options.gaussians as f64, 1.0, PergamOptions::GAUSSIANS_MAX as f64, "1 to 20")?;
        let period_secs = options.period_nanos as f64 / 1e9;
        check_range("period_secs", period_secs, 1.0, PERIOD_MAX_NANOS as f64 / 1e9, "1 s to 100 years")?;
        check_values(readings, 0.0..=1.0, "0 to 1")?;
        let folded = PhaseMeans::new(readings, options.period_nanos);
        let level = folded.level();
        let found = train_wrapped(folded.shares(), options.gaussians, options.seed, readings.stop);
        readings.stop.check()?;
        let gaussians = found.iter().map(|wrapped| PergamGaussian {
            weight: wrapped.weight * level,
            mean_secs: (wrapped.mean * period_secs).clamp(0.0, period_secs),
            deviation_secs: wrapped.deviation * period_secs,
        });
        Ok(Pergam::of(PergamParts { period_nanos: options.period_nanos, gaussians: gaussians.collect() }))
    }

    /// Builds the model from its stored parts, so that a stored model has equal predictions to the last bit.
    fn of(parts: PergamParts) -> Pergam {
        let period_secs = parts.period_nanos as f64 / 1e9;
        let wrapped = parts.gaussians.iter().map(|gaussian| WrappedGaussian {
            weight: gaussian.weight,
            mean: gaussian.mean_secs / period_secs,
            deviation: gaussian.deviation_secs / period_secs,
        });
        Pergam { wrapped: wrapped.collect(), parts }
    }

    /// The model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where there are too many Gaussians or a number is outside its range.
    pub fn from_parts(parts: &PergamParts) -> Result<Pergam, InvalidParts> {
        let period_secs = parts.period_nanos as f64 / 1e9;
        InvalidParts::check("period_secs", period_secs, 1.0..=PERIOD_MAX_NANOS as f64 / 1e9)?;
        InvalidParts::check("gaussians", parts.gaussians.len() as f64, 0.0..=PergamOptions::GAUSSIANS_MAX as f64)?;
        for gaussian in &parts.gaussians {
            // The upper limit leaves room for rounding.
            InvalidParts::check("weight", gaussian.weight, 0.0..=1.01)?;
            InvalidParts::check("mean_secs", gaussian.mean_secs, 0.0..=period_secs)?;
            InvalidParts::check("deviation_secs", gaussian.deviation_secs, period_secs * 1e-6..=period_secs * 1.01)?;
        }
        Ok(Pergam::of(parts.clone()))
    }

    /// The parts of the model; a model built from them is equal to the last bit.
    pub fn to_parts(&self) -> PergamParts {
        self.parts.clone()
    }

    /// The period τ, in seconds.
    pub fn period_secs(&self) -> f64 {
        self.parts.period_nanos as f64 / 1e9
    }
}

impl TemporalModel for Pergam {
    /// The probability at a moment (Waldo eq. 7), saturated to `[0,1]`.
    fn predict(&self, at: Moment) -> f64 {
        let turn = phases::turn(at.civil_nanos(), self.parts.period_nanos);
        let sum: f64 = self.wrapped.iter().map(|gaussian| gaussian.weight * gaussian.density(turn)).sum();
        sum.clamp(0.0, 1.0)
    }
}

fn check_range(
    parameter: &'static str,
    found: f64,
    low: f64,
    high: f64,
    expected: &'static str,
) -> Result<(), CannotTrain> {
    if (low..=high).contains(&found) { Ok(()) } else { Err(CannotTrain::Parameter { parameter, found, expected }) }
}
