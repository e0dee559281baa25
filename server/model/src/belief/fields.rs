//! The stored fields of a [`Belief`], without its sensor.
//!
//! Invariant: a belief that was written is read back as it was, to which the sensor is given again; a wrong length or a
//! number out of range is refused.

use std::{ops::RangeInclusive, slice};

use super::{
    Belief, Recent, RecentSpan,
    dwell::{DWELLS_MAX, OfValue, UnendedDwell},
    lead_time::LeadTimeWeights,
    noise::NOISE_MAX,
};
use crate::{
    InvalidParts, StateKind,
    fields::{FINITE, NOT_NEGATIVE, Packed, StoredFields, Visitor},
    models::markov_chain::likelihood::{GapCounts, Transitions},
};

/// Every finite number above 0.
const POSITIVE: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::MAX;

/// Octave, number and seconds of the pairs, pairs that stayed 0, rose, fell and stayed 1.
type Octave = [f64; 7];

impl StoredFields for Belief {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "a state of two values", &mut self.has_two_values)?;
        visitor.messages(2, "newest learned reading", &mut self.newest)?;
        let recent = |spans: Vec<RecentSpan>| Recent::from_spans(&spans);
        visitor.converted(3, "recent readings", &mut self.recent, |recent| recent.spans().to_vec(), recent)?;
        let (seen_rates, hidden_rates) = (&mut self.seen_rates, &mut self.hidden_rates);
        let (errors, noise) = (&mut self.errors, &mut self.noise);
        let numbers = [
            &mut seen_rates.rise_per_sec,
            &mut seen_rates.fall_per_sec,
            &mut hidden_rates.rise_per_sec,
            &mut hidden_rates.fall_per_sec,
            &mut errors.ones,
            &mut errors.misses,
            &mut errors.zeros,
            &mut errors.false_alarms,
            &mut noise.miss,
            &mut noise.false_alarm,
            &mut self.gain,
        ];
        visitor.lists(4, "numbers of a belief", FINITE, &mut numbers.map(slice::from_mut))?;
        visitor.converted(5, "gaps between readings", &mut self.seen, octaves, transitions)?;
        visitor.converted(6, "gaps between hidden values", &mut self.hidden, octaves, transitions)?;
        visitor.integer(7, "learned days of a belief", &mut self.days)?;
        visitor.messages(8, "values with dwells", &mut self.dwells.of_value)?;
        visitor.messages(9, "dwell that has not ended", &mut self.dwells.open)?;
        let weights = |sums: Vec<f64>| LeadTimeWeights::from_sums(&sums);
        visitor.converted(10, "sums by lead time", &mut self.weights, LeadTimeWeights::to_sums, weights)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        for rates in [self.seen_rates, self.hidden_rates] {
            InvalidParts::check("rate of a chain", rates.rise_per_sec, f64::MIN_POSITIVE..=1e12)?;
            InvalidParts::check("rate of a chain", rates.fall_per_sec, f64::MIN_POSITIVE..=1e12)?;
        }
        for sum in [self.errors.ones, self.errors.misses, self.errors.zeros, self.errors.false_alarms] {
            InvalidParts::check("expected readings", sum, NOT_NEGATIVE)?;
        }
        for error in [self.noise.miss, self.noise.false_alarm] {
            InvalidParts::check("sensor noise", error, 0.0..=NOISE_MAX)?;
        }
        self.dwells.build();
        Ok(())
    }
}

impl Belief {
    /// The belief that was read, if it can be of a state of this kind.
    ///
    /// # Errors
    /// [`InvalidParts`] where the newest value lies outside the bounds of the kind.
    pub fn of_kind(self, kind: StateKind) -> Result<Belief, InvalidParts> {
        if let Some((_, value)) = self.newest {
            InvalidParts::check("newest learned value", value, kind.bounds())?;
        }
        Ok(Belief { has_two_values: self.has_two_values && kind == StateKind::Probability, ..self })
    }
}

impl StoredFields for OfValue {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.list(1, "length of a dwell", NOT_NEGATIVE, &mut self.secs)?;
        visitor.integer(2, "number of dwells", &mut self.count)?;
        visitor.list(3, "length of a dwell", NOT_NEGATIVE, &mut self.fresh)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        let (kept, count) = (self.secs.len(), self.count);
        if kept > DWELLS_MAX || kept as u64 > u64::from(count) || (count > 0 && kept == 0) {
            return Err(InvalidParts::OutOfRange { field: "number of dwells", found: kept as f64 });
        }
        Ok(())
    }
}

impl StoredFields for UnendedDwell {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let (mut since, secs) = self.since.unzip();
        let mut secs = secs.unwrap_or(0.0);
        visitor.integer(1, "value of a dwell", &mut self.is_one)?;
        visitor.integer(2, "begin of a dwell", &mut since)?;
        visitor.number(3, "uncertainty of the begin of a dwell", NOT_NEGATIVE, &mut secs)?;
        self.since = since.map(|since| (since, secs));
        visitor.integer(4, "newest reading of a dwell", &mut self.last_nanos)
    }
}

fn octaves(transitions: &Transitions) -> Vec<Octave> {
    let octave = |(&octave, counts): (&i32, &GapCounts)| {
        let &GapCounts { weight, gap_secs_sum, low, rises, falls, high } = counts;
        [f64::from(octave), weight, gap_secs_sum, low, rises, falls, high]
    };
    transitions.by_gap.iter().map(octave).collect()
}

fn transitions(octaves: Vec<Octave>) -> Result<Transitions, InvalidParts> {
    let mut transitions = Transitions::default();
    for [octave, weight, gap_secs_sum, low, rises, falls, high] in octaves {
        InvalidParts::check("octave of a gap", octave, 0.0..=63.0)?;
        InvalidParts::check("number of pairs", weight, POSITIVE)?;
        InvalidParts::check("sum of gaps", gap_secs_sum, POSITIVE)?;
        for count in [low, rises, falls, high] {
            InvalidParts::check("count of pairs", count, NOT_NEGATIVE)?;
        }
        transitions.by_gap.insert(octave as i32, GapCounts { weight, gap_secs_sum, low, rises, falls, high });
    }
    Ok(transitions)
}

/// Nanoseconds of the first reading, milliseconds from it to the last reading, number of readings of 1 and of 0.
impl Packed for RecentSpan {
    const BYTES: usize = 16;

    fn put(&self, bytes: &mut Vec<u8>) {
        self.first_nanos.put(bytes);
        self.length_millis.put(bytes);
        self.ones.put(bytes);
        self.zeros.put(bytes);
    }

    fn take(bytes: &[u8]) -> RecentSpan {
        let after = |at: usize| bytes.get(at..).unwrap_or_default();
        RecentSpan {
            first_nanos: Packed::take(bytes),
            length_millis: Packed::take(after(8)),
            ones: Packed::take(after(12)),
            zeros: Packed::take(after(14)),
        }
    }
}
