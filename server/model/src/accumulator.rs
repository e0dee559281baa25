//! The sums over a state's observations from which its spectral model follows.
//!
//! n, S = Σ s, Σ s², A_k = Σ s·e^(-jω_k t), B_k = Σ e^(-jω_k t) (design after T-RO eq. 11, which keeps running means
//! instead). Between updates, a state with few readings keeps them in place of A_k and B_k. Invariant: sums commute, so
//! γ_k does not depend on order or batching beyond 1e-9; without observations there is no spectrum.

use std::borrow::Cow;

use crate::special::square;
use crate::{InvalidParts, Periodicities, Sample, StateKind, instruction_set::arch, lanes::OnLanes};

mod fold;
mod short_record;
mod spectrum_cell;

use fold::CHUNK;
pub use short_record::ShortRecord;
pub use spectrum_cell::{SpectrumCell, SpectrumSource};

#[cfg(test)]
mod tests;

/// The total weight never falls below this.
const WEIGHT_MIN: f64 = 1e-9;

/// Sums over the observations of one state.
#[derive(Clone, Debug)]
pub struct Accumulator {
    kind: StateKind,
    parts: AccumulatorParts,
    /// The spectrum of a packed accumulator whose readings are not stored.
    cell: Option<SpectrumCell>,
}

/// The parts of an [`Accumulator`], for storage.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct AccumulatorParts {
    /// Number of observations n.
    pub observations: u64,
    /// Total weight: n, or less with forgetting.
    pub weight: f64,
    /// Sum of values S, weighted like all sums here.
    pub sum: f64,
    /// Sum of squared values.
    pub sum_squares: f64,
    /// First observation, UTC in nanoseconds since 1970; 0 where n = 0.
    pub first_nanos: i64,
    /// Last observation, UTC in nanoseconds since 1970; 0 where n = 0.
    pub last_nanos: i64,
    /// `[re A_k, im A_k, re B_k, im B_k]` per periodicity; empty where n = 0 or the readings are stored.
    pub spectrum: Vec<[f64; 4]>,
    /// All readings, if there are few of them. The spectrum is computed from them.
    pub short: Option<ShortRecord>,
}

impl Accumulator {
    /// Empty sums of a probability.
    pub fn new(_periodicities: &Periodicities) -> Accumulator {
        Accumulator::of_kind(StateKind::Probability)
    }

    /// Empty sums of a state of the given kind.
    pub fn of_kind(kind: StateKind) -> Accumulator {
        Accumulator { kind, parts: AccumulatorParts::default(), cell: None }
    }

    /// The meaning of the values.
    pub fn kind(&self) -> StateKind {
        self.kind
    }

    /// Number of observations n.
    pub fn observations(&self) -> u64 {
        self.parts.observations
    }

    /// Total weight of the observations: n, or less with forgetting.
    pub fn weight(&self) -> f64 {
        self.parts.weight
    }

    /// Mean value μ = S/n. Without observations 0.5 for a probability, else 0.
    pub fn mean(&self) -> f64 {
        if self.parts.observations == 0 {
            return self.kind.untrained();
        }
        self.kind.saturate(self.parts.sum / self.parts.weight)
    }

    /// Variance of the values around their mean, at least 0; 0 where nothing was observed. Precise to some 1e-15 of the
    /// square of the mean.
    pub fn variance(&self) -> f64 {
        if self.parts.observations == 0 {
            return 0.0;
        }
        (self.parts.sum_squares / self.parts.weight - square(self.mean())).max(0.0)
    }

    /// Time of the first observation, UTC in nanoseconds since 1970.
    pub fn first_nanos(&self) -> Option<i64> {
        (self.parts.observations > 0).then_some(self.parts.first_nanos)
    }

    /// Time of the last observation, UTC in nanoseconds since 1970.
    pub fn last_nanos(&self) -> Option<i64> {
        (self.parts.observations > 0).then_some(self.parts.last_nanos)
    }

    /// The observed span, last less first, in nanoseconds.
    pub(crate) fn span_nanos(&self) -> u64 {
        self.parts.last_nanos.abs_diff(self.parts.first_nanos)
    }

    /// `[re A_k, im A_k, re B_k, im B_k]` per periodicity; empty after [`Accumulator::pack`] has freed it.
    #[cfg(test)]
    pub(crate) fn spectrum(&self) -> &[[f64; 4]] {
        &self.parts.spectrum
    }

    /// Adds observations, in any order and batching. The periodicities must be the same in every call.
    pub fn add(&mut self, periodicities: &Periodicities, samples: &[Sample]) {
        debug_assert!(self.cell.is_none(), "unpacked");
        self.unpack_short(periodicities);
        let parts = &mut self.parts;
        if let (0, Some(sample)) = (parts.observations, samples.first()) {
            (parts.first_nanos, parts.last_nanos) = (sample.utc_nanos, sample.utc_nanos);
            parts.spectrum = vec![[0.0; 4]; periodicities.len()];
            parts.short = Some(ShortRecord::default());
        }
        parts.short = parts.short.take().and_then(|short| short.with(samples, periodicities.len()));
        let arch = arch();
        for chunk in samples.chunks(CHUNK) {
            // Each chunk is summed on its own first: a long sum then has far fewer roundings.
            let (mut sum, mut sum_squares) = (0.0, 0.0);
            for sample in chunk {
                sum += sample.value;
                sum_squares += sample.value * sample.value;
                parts.first_nanos = parts.first_nanos.min(sample.utc_nanos);
                parts.last_nanos = parts.last_nanos.max(sample.utc_nanos);
            }
            parts.observations += chunk.len() as u64;
            parts.weight += chunk.len() as f64;
            parts.sum += sum;
            parts.sum_squares += sum_squares;
            let (cycles, spectrum) = (periodicities.cycles(), &mut parts.spectrum[..]);
            arch.dispatch(OnLanes(fold::Fold { cycles, samples: chunk, spectrum }));
        }
    }

    fn unpack_short(&mut self, periodicities: &Periodicities) {
        let parts = &mut self.parts;
        if let Some(short) = parts.short.as_ref().filter(|short| parts.spectrum.is_empty() && !short.batches.is_empty())
        {
            parts.spectrum = spectrum_of(short, periodicities);
        }
    }

    /// Restores the spectrum to its state before [`Accumulator::pack`].
    ///
    /// # Errors
    /// Returns the reason if the spectrum cannot be read. The accumulator is then unchanged.
    pub(crate) fn unpack(&mut self, periodicities: &Periodicities) -> Result<(), String> {
        self.unpack_short(periodicities);
        if let Some(cell) = &self.cell {
            self.parts.spectrum = cell.read()?;
            self.cell = None;
        }
        Ok(())
    }

    /// Frees the spectrum if it follows from the readings; otherwise moves it to a cell that clones share.
    pub(crate) fn pack(&mut self) {
        let spectrum = std::mem::take(&mut self.parts.spectrum);
        if self.parts.short.is_none() && !spectrum.is_empty() {
            self.cell = Some(SpectrumCell::new(spectrum));
        }
    }

    /// The place where the spectrum is stored; `None` if it is computed from the readings, or there is none.
    pub fn cell(&self) -> Option<&SpectrumCell> {
        self.cell.as_ref()
    }

    /// The spectrum. It is read or computed if it is not in memory, and is empty if it cannot be read.
    pub(crate) fn unpacked_spectrum(&self, periodicities: &Periodicities) -> Cow<'_, [[f64; 4]]> {
        match (&self.cell, &self.parts.short) {
            (Some(cell), _) => Cow::Owned(cell.read().unwrap_or_default()),
            (None, Some(short)) if self.parts.spectrum.is_empty() => Cow::Owned(spectrum_of(short, periodicities)),
            _ => Cow::Borrowed(&self.parts.spectrum),
        }
    }

    /// Multiplies the weight of all data learned so far by `factor`, above 0 and at most 1 (forgetting). The number and
    /// the span of the observations do not change. The spectrum must be in memory.
    pub(crate) fn fade(&mut self, factor: f64) {
        let parts = &mut self.parts;
        // A weight of 0 could not be divided by.
        let factor = factor.clamp(0.0, 1.0).max(WEIGHT_MIN / parts.weight.max(WEIGHT_MIN));
        parts.weight *= factor;
        parts.sum *= factor;
        parts.sum_squares *= factor;
        for entry in parts.spectrum.as_flattened_mut() {
            *entry *= factor;
        }
        if factor != 1.0 {
            parts.short = None;
        }
    }

    /// Adds the sums of another accumulator. Both spectra must be in memory.
    pub(crate) fn merge(&mut self, other: &Accumulator) {
        if self.parts.observations == 0 {
            self.parts = other.parts.clone();
            return;
        }
        if other.parts.observations == 0 {
            return;
        }
        let (parts, other) = (&mut self.parts, &other.parts);
        parts.short = None;
        parts.observations += other.observations;
        parts.weight += other.weight;
        parts.sum += other.sum;
        parts.sum_squares += other.sum_squares;
        parts.first_nanos = parts.first_nanos.min(other.first_nanos);
        parts.last_nanos = parts.last_nanos.max(other.last_nanos);
        for (entry, other) in parts.spectrum.as_flattened_mut().iter_mut().zip(other.spectrum.as_flattened()) {
            *entry += other;
        }
    }

    /// The parts to store.
    ///
    /// # Errors
    /// Returns the reason if the spectrum cannot be read.
    pub fn stored_parts(&self) -> Result<AccumulatorParts, String> {
        let spectrum = match &self.cell {
            Some(cell) => cell.read()?,
            None if self.parts.short.is_some() => Vec::new(),
            None => self.parts.spectrum.clone(),
        };
        Ok(AccumulatorParts { spectrum, short: self.parts.short.clone(), ..self.published().parts })
    }

    /// The parts to store; without the spectrum if it cannot be read.
    pub fn to_parts(&self) -> AccumulatorParts {
        self.stored_parts().unwrap_or_else(|_| self.published().parts)
    }

    /// The parts with the spectrum, even if the readings are stored.
    pub fn to_summed_parts(&self, periodicities: &Periodicities) -> AccumulatorParts {
        let spectrum = self.unpacked_spectrum(periodicities).into_owned();
        AccumulatorParts { spectrum, ..self.published().parts }
    }

    /// The accumulator of a probability from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where the spectrum does not fit the periodicities or a number is outside its range.
    pub fn from_parts(periodicities: &Periodicities, parts: AccumulatorParts) -> Result<Accumulator, InvalidParts> {
        Accumulator::from_parts_of(StateKind::Probability, periodicities, parts)
    }

    /// The accumulator of a state of the given kind from stored parts.
    ///
    /// # Errors
    /// Returns the same errors as [`Accumulator::from_parts`].
    pub fn from_parts_of(
        kind: StateKind,
        periodicities: &Periodicities,
        parts: AccumulatorParts,
    ) -> Result<Accumulator, InvalidParts> {
        let is_summed = parts.observations > 0 && parts.short.is_none();
        let expected = if is_summed { periodicities.len() } else { 0 };
        Accumulator::checked(kind, expected, parts)
    }

    /// An accumulator from stored parts, without its spectrum: the form that readers have
    /// ([`crate::StateModel::published`]).
    ///
    /// # Errors
    /// [`InvalidParts`] where there is a spectrum or a number is outside its range.
    pub fn published_from_parts(kind: StateKind, parts: AccumulatorParts) -> Result<Accumulator, InvalidParts> {
        Accumulator::checked(kind, 0, parts)
    }

    /// A copy without the spectrum and the readings, which only an update needs.
    pub(crate) fn published(&self) -> Accumulator {
        let AccumulatorParts { observations, weight, sum, sum_squares, first_nanos, last_nanos, .. } = self.parts;
        let (spectrum, short) = (Vec::new(), None);
        let parts =
            AccumulatorParts { observations, weight, sum, sum_squares, first_nanos, last_nanos, spectrum, short };
        Accumulator { kind: self.kind, parts, cell: None }
    }

    /// Checks the parts; the spectrum must have the length `expected`.
    fn checked(kind: StateKind, expected: usize, parts: AccumulatorParts) -> Result<Accumulator, InvalidParts> {
        if parts.spectrum.len() != expected {
            return Err(InvalidParts::SpectrumLength { expected, found: parts.spectrum.len() });
        }
        let (first_nanos, last_nanos) = (parts.first_nanos, parts.last_nanos);
        if first_nanos > last_nanos {
            return Err(InvalidParts::TimesReversed { first_nanos, last_nanos });
        }
        // The limit leaves room for the rounding of long sums.
        let highest = parts.weight * (1.0 + 1e-9);
        let lowest = if parts.observations == 0 { 0.0 } else { f64::MIN_POSITIVE };
        InvalidParts::check("weight", parts.weight, lowest..=parts.observations as f64)?;
        let magnitude = kind.magnitude();
        InvalidParts::check("sum", parts.sum, highest * kind.bounds().start()..=highest * magnitude)?;
        InvalidParts::check("sum of squares", parts.sum_squares, 0.0..=highest * magnitude * magnitude)?;
        if let Some(short) = &parts.short {
            short.check(kind, parts.observations)?;
        }
        for &entry in parts.spectrum.as_flattened() {
            InvalidParts::check("spectrum", entry, -highest * magnitude..=highest * magnitude)?;
        }
        Ok(Accumulator { kind, parts, cell: None })
    }
}

fn spectrum_of(short: &ShortRecord, periodicities: &Periodicities) -> Vec<[f64; 4]> {
    let mut spectrum = vec![[0.0; 4]; periodicities.len()];
    let (arch, cycles) = (arch(), periodicities.cycles());
    for batch in short.batches() {
        // A batch has at most as many readings as there are periodicities.
        for samples in batch.chunks(CHUNK) {
            arch.dispatch(OnLanes(fold::Fold { cycles, samples, spectrum: &mut spectrum[..] }));
        }
    }
    spectrum
}

impl PartialEq for Accumulator {
    /// Whether the sums are equal, wherever they are stored. Sums that are computed from readings are equal if the
    /// readings are equal.
    fn eq(&self, other: &Accumulator) -> bool {
        let is_stored_alike = || match (self.stored_parts(), other.stored_parts()) {
            (Ok(one), Ok(other)) => one == other,
            _ => false,
        };
        self.kind == other.kind && is_stored_alike()
    }
}
