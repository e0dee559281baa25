//! The uniform variant of FreMEn: a regularly sampled binary state as the strongest components of its Fourier transform
//! and the set of outliers that they miss, from which every state can be reconstructed exactly.
//!
//! T-RO section III.B. The crate's spectral model needs neither regular samples nor a transform of all of them; this
//! one stores the history. Invariant: `reconstruct` returns exactly the states trained on and appended, for any order.

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

use super::mean::check_values;
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::{Component, InvalidParts, ORDER_MAX, Sample, StopSignal};

mod gaps;
mod regular;

use regular::{STEPS_MAX, off_time, regular};

#[cfg(test)]
mod tests;

/// A probability within this below 0.5 counts as 0.5: components of a square wave meet there exactly, and machines that
/// round the last digit differently must get equal results.
const TIE: f64 = 1e-9;
/// Weaker components are rounding errors.
const GAMMA_MIN: f64 = 1e-12;
/// Number of states between two checks of the stop signal.
const STATES_PER_CHECK: usize = 4096;
/// A regularly sampled binary state (T-RO, section III.B).
///
/// Time is counted in steps: reading i was made i intervals (UTC) after the first. Predictions follow the local clock,
/// so that a model trained in winter keeps its hours in summer.
#[derive(Clone, Debug, PartialEq)]
pub struct UniformSpectral {
    parts: UniformSpectralParts,
    /// The decoded outlier set: the steps at which the estimate starts and stops differing from the state, ascending.
    outliers: Vec<u32>,
}

/// The parts of a [`UniformSpectral`], for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct UniformSpectralParts {
    /// Time of the first reading: UTC, nanoseconds since 1970.
    pub first_nanos: i64,
    /// The UTC offset of the map's zone then, in seconds, east positive.
    pub offset_secs: i32,
    /// Time between readings, in nanoseconds, at least 1.
    pub interval_nanos: i64,
    /// Number of readings that the spectrum was trained on, at least 2: component k turns k times in that many steps.
    pub trained_steps: u32,
    /// Number of stored readings, at least `trained_steps`.
    pub steps: u32,
    /// Mean of the readings that the spectrum was trained on, in `[0,1]`.
    pub mean: f64,
    /// The components P, strongest first, at most [`ORDER_MAX`]: index k from 1 to half of `trained_steps`, phase 0 at
    /// the first reading.
    pub components: Vec<Component>,
    /// The outlier set O, Δ-encoded: from step 0 on, the number of steps to where the estimate p ≥ 0.5 starts differing
    /// from the state, from there to where it stops, and so on; 7 bits a byte, the lowest first, the top bit set where
    /// more follow.
    pub outlier_gaps: Vec<u8>,
}

impl UniformSpectral {
    /// Trains the `order` strongest components of the readings' Fourier transform, and the outliers that they leave.
    /// All readings have equal weight.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are fewer than two readings, a value is neither 0 nor 1, or the order is above
    /// [`ORDER_MAX`]; [`CannotTrain::Irregular`] where a reading lies over 1 % of the interval off its regular time.
    pub fn train(readings: Readings<'_>, order: usize) -> Result<UniformSpectral, CannotTrain> {
        check_values(readings, 0.0..=1.0, "0 or 1")?;
        let samples = readings.samples;
        let states = samples.iter().map(binary).collect::<Result<Vec<bool>, CannotTrain>>()?;
        let (first, interval_nanos) = regular(samples)?;
        let header = UniformSpectralParts {
            first_nanos: first.utc_nanos,
            offset_secs: first.offset_secs,
            interval_nanos,
            trained_steps: 0,
            steps: 0,
            mean: 0.5,
            components: Vec::new(),
            outlier_gaps: Vec::new(),
        };
        UniformSpectral::of_states(&header, &states, order, readings.stop)
    }

    /// The model of all stored states with another order: the update of T-RO III.B.3. It loses no information.
    ///
    /// # Errors
    /// [`CannotTrain`] where the order is above [`ORDER_MAX`].
    pub fn with_order(&self, order: usize) -> Result<UniformSpectral, CannotTrain> {
        UniformSpectral::of_states(&self.parts, &self.reconstruct(), order, StopSignal::NEVER)
    }

    fn of_states(
        header: &UniformSpectralParts,
        states: &[bool],
        order: usize,
        stop: StopSignal<'_>,
    ) -> Result<UniformSpectral, CannotTrain> {
        if order > ORDER_MAX {
            return Err(CannotTrain::Parameter { parameter: "order", found: order as f64, expected: "0 to 15" });
        }
        let steps = states.len() as u32;
        let (mean, components) = strongest(states, order)?;
        let parts = UniformSpectralParts {
            trained_steps: steps,
            steps: 0,
            mean,
            components,
            outlier_gaps: Vec::new(),
            ..header.clone()
        };
        let mut model = UniformSpectral { parts, outliers: Vec::new() };
        for chunk in states.chunks(STATES_PER_CHECK) {
            stop.check()?;
            chunk.iter().for_each(|&state| model.append_state(state));
        }
        stop.check()?;
        Ok(model)
    }

    /// Appends the next reading without changing the spectrum (T-RO eq. 8): where the prediction starts or stops
    /// differing from the state, the outlier set grows.
    ///
    /// # Errors
    /// [`CannotTrain`] where the value is neither 0 nor 1 or the time is not one interval after the last reading's.
    pub fn append(&mut self, sample: &Sample) -> Result<(), CannotTrain> {
        let state = binary(sample)?;
        let parts = &self.parts;
        if u64::from(parts.steps) >= STEPS_MAX || off_time(sample, parts.first_nanos, parts.interval_nanos, parts.steps)
        {
            return Err(CannotTrain::Parameter {
                parameter: "time of a reading in seconds after the first",
                found: (i128::from(sample.utc_nanos) - i128::from(parts.first_nanos)) as f64 / 1e9,
                expected: "one interval after the last reading",
            });
        }
        self.append_state(state);
        Ok(())
    }

    fn append_state(&mut self, state: bool) {
        let step = self.parts.steps;
        let is_outlier = self.estimate(step) != state;
        let was_outlier = self.outliers.len() % 2 == 1;
        if is_outlier != was_outlier {
            gaps::push(&mut self.parts.outlier_gaps, step - self.outliers.last().copied().unwrap_or(0));
            self.outliers.push(step);
        }
        self.parts.steps = step + 1;
    }

    /// All stored states, in order: s(t) = (p(t) ≥ 0.5) ⊕ (t ∈ O), T-RO eq. 7.
    pub fn reconstruct(&self) -> Vec<bool> {
        let mut outliers = self.outliers.iter().peekable();
        let mut is_outlier = false;
        let state = |step: u32| {
            if outliers.next_if(|&&change| change <= step).is_some() {
                is_outlier = !is_outlier;
            }
            self.estimate(step) != is_outlier
        };
        (0..self.parts.steps).map(state).collect()
    }

    /// The state at one step; `None` beyond the last.
    pub fn state(&self, step: u32) -> Option<bool> {
        let changes = self.outliers.partition_point(|&change| change <= step);
        (step < self.parts.steps).then(|| self.estimate(step) != (changes % 2 == 1))
    }

    /// The share of stored states that the spectrum alone predicts wrongly, 0 to 1: the estimation error of T-RO eq.
    /// 15.
    pub fn estimation_error(&self) -> f64 {
        let ends = self.outliers.chunks(2).map(|run| {
            let until = run.get(1).copied().unwrap_or(self.parts.steps);
            f64::from(until - run[0])
        });
        ends.sum::<f64>() / f64::from(self.parts.steps)
    }

    /// The compression ratio r = m/z of T-RO eq. 16 for one state: m readings would take one bit each, and z is the
    /// size of the stored parts, in bits. It is lossless with the outlier set and lossy without it.
    ///
    /// The size is that of [`UniformSpectralParts`]: 288 bits, 160 a component and the bytes of the outlier set.
    pub fn compression_ratio(&self, with_outliers: bool) -> f64 {
        let outlier_bits = if with_outliers { 8 * self.parts.outlier_gaps.len() } else { 0 };
        let bits = 64 + 32 + 64 + 32 + 32 + 64 + 160 * self.parts.components.len() + outlier_bits;
        f64::from(self.parts.steps) / bits as f64
    }

    /// Mean of the readings that the spectrum was trained on, in `[0,1]`.
    pub fn mean(&self) -> f64 {
        self.parts.mean
    }

    /// The components, strongest first; periodicity k has a period of the span (steps times interval) over k.
    pub fn components(&self) -> &[Component] {
        &self.parts.components
    }

    /// The steps at which the prediction starts and stops differing from the state.
    pub fn outliers(&self) -> &[u32] {
        &self.outliers
    }

    /// Number of stored states.
    pub fn steps(&self) -> u32 {
        self.parts.steps
    }

    /// p(t) by the mean and the `order` strongest components, or all if there are fewer.
    pub fn predict_at_order(&self, order: usize, at: Moment) -> f64 {
        let parts = &self.parts;
        let first = Moment { utc_nanos: parts.first_nanos, offset_secs: parts.offset_secs };
        let span_nanos = i128::from(parts.interval_nanos) * i128::from(parts.trained_steps);
        let elapsed_nanos = i128::from(at.civil_nanos()) - i128::from(first.civil_nanos());
        let elapsed_nanos = elapsed_nanos.rem_euclid(span_nanos);
        self.probability(order, |k| (elapsed_nanos * i128::from(k) % span_nanos) as f64 / span_nanos as f64)
    }

    /// The observed value, if it is an outlier of the model of this order: the reading nearest to the moment, at most
    /// half an interval away, is on the other side of 0.5 than the prediction of the spectrum. `None` otherwise, and
    /// beyond the stored readings.
    pub fn outlier_at(&self, order: usize, at: Moment) -> Option<bool> {
        let interval_nanos = i128::from(self.parts.interval_nanos);
        let elapsed_nanos = i128::from(at.utc_nanos) - i128::from(self.parts.first_nanos);
        let step = (2 * elapsed_nanos + interval_nanos).div_euclid(2 * interval_nanos);
        let step = u32::try_from(step).ok()?;
        self.state(step).filter(|&state| self.estimate_at_order(order, step) != state)
    }

    /// s'(t): the state at a step by the spectrum alone (T-RO eq. 9 with c = 0.5).
    fn estimate(&self, step: u32) -> bool {
        self.estimate_at_order(ORDER_MAX, step)
    }

    fn estimate_at_order(&self, order: usize, step: u32) -> bool {
        let trained = u64::from(self.parts.trained_steps);
        // k·step modulo the span in integers, so that a late step has the same phase as when it was encoded.
        let turns = |k: u32| (u64::from(k) * u64::from(step) % trained) as f64 / trained as f64;
        self.probability(order, turns) >= 0.5 - TIE
    }

    /// p by the phase of each of the first `order` components, in turns.
    fn probability(&self, order: usize, turns: impl Fn(u32) -> f64) -> f64 {
        let mut p = self.parts.mean;
        for component in self.parts.components.iter().take(order) {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * turns(component.periodicity));
            let term = component.gamma_re * cos - component.gamma_im * sin;
            // At half the sampling rate a component is its own mirror image and enters once.
            let is_fastest = 2 * u64::from(component.periodicity) == u64::from(self.parts.trained_steps);
            p += if is_fastest { term } else { 2.0 * term };
        }
        p.clamp(0.0, 1.0)
    }

    /// The parts to store.
    pub fn to_parts(&self) -> UniformSpectralParts {
        self.parts.clone()
    }

    /// A model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range or there are too many components.
    pub fn from_parts(parts: UniformSpectralParts) -> Result<UniformSpectral, InvalidParts> {
        InvalidParts::check("interval", parts.interval_nanos as f64, 1.0..=i64::MAX as f64)?;
        InvalidParts::check("trained steps", f64::from(parts.trained_steps), 2.0..=f64::from(parts.steps))?;
        InvalidParts::check("mean", parts.mean, 0.0..=1.0)?;
        if parts.components.len() > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: parts.components.len() });
        }
        for component in &parts.components {
            let highest = f64::from(parts.trained_steps / 2);
            InvalidParts::check("component index", f64::from(component.periodicity), 1.0..=highest)?;
            InvalidParts::check("gamma_re", component.gamma_re, -1.01..=1.01)?;
            InvalidParts::check("gamma_im", component.gamma_im, -1.01..=1.01)?;
        }
        let outliers = gaps::decode(&parts.outlier_gaps, parts.steps)?;
        Ok(UniformSpectral { parts, outliers })
    }
}

impl TemporalModel for UniformSpectral {
    /// p(t) from the spectrum alone, continued periodically before and after its readings (T-RO eq. 10).
    fn predict(&self, at: Moment) -> f64 {
        self.predict_at_order(ORDER_MAX, at)
    }
}

/// A sample's state, 0 or 1.
fn binary(sample: &Sample) -> Result<bool, CannotTrain> {
    let (parameter, found, expected) = ("a reading's value", sample.value, "0 or 1");
    let distance = |state: f64| (found - state).abs();
    // NaN is neither.
    if distance(1.0) <= f64::EPSILON {
        Ok(true)
    } else if distance(0.0) <= f64::EPSILON {
        Ok(false)
    } else {
        Err(CannotTrain::Parameter { parameter, found, expected })
    }
}

/// Mean and strongest components of the transform; of equal components the slower comes first.
fn strongest(states: &[bool], order: usize) -> Result<(f64, Vec<Component>), CannotTrain> {
    let transform = RealFftPlanner::<f64>::new().plan_fft_forward(states.len());
    let mut values: Vec<f64> = states.iter().map(|&state| f64::from(u8::from(state))).collect();
    let mut spectrum: Vec<Complex<f64>> = transform.make_output_vec();
    let (parameter, expected) = ("number of readings", "a length that can be transformed");
    let refused = |_| CannotTrain::Parameter { parameter, found: states.len() as f64, expected };
    transform.process(&mut values, &mut spectrum).map_err(refused)?;
    let per_reading = 1.0 / states.len() as f64;
    let mean = (spectrum[0].re * per_reading).clamp(0.0, 1.0);
    let component = |(k, sum): (usize, &Complex<f64>)| Component {
        periodicity: k as u32,
        gamma_re: sum.re * per_reading,
        gamma_im: sum.im * per_reading,
    };
    let mut components: Vec<Component> = spectrum.iter().enumerate().skip(1).map(component).collect();
    components.retain(|component| component.amplitude() > 2.0 * GAMMA_MIN);
    // A stable sort keeps ties in the order of their index.
    components.sort_by(|a, b| b.amplitude().total_cmp(&a.amplitude()));
    components.truncate(order);
    Ok((mean, components))
}
