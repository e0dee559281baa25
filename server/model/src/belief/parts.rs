//! The stored form of a [`Belief`], without its sensor.
//!
//! Invariant: a round trip gives the same belief, to which the sensor is given again; invalid parts are refused.

use super::{
    Belief, Rates, Recent, RecentSpan, SensorNoise,
    dwell::{DWELLS_MAX, Dwells, OfValue, UnendedDwell},
    lead_time::LeadTimeWeights,
    noise::{ErrorSums, NOISE_MAX},
};
use crate::{
    InvalidParts, StateKind,
    models::markov_chain::likelihood::{GapCounts, Transitions},
};

/// The parts of a [`Belief`], for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BeliefParts {
    /// Whether every learned reading was 0 or 1.
    pub has_two_values: bool,
    /// UTC nanoseconds and value of the newest learned reading.
    pub newest: Option<(i64, f64)>,
    /// The recent learned readings.
    pub recent: Vec<RecentSpan>,
    /// Counts of successive readings.
    pub seen: Vec<GapCountParts>,
    /// Rise and fall per second that make `seen` most likely.
    pub seen_rates: [f64; 2],
    /// Expected counts of successive hidden values.
    pub hidden: Vec<GapCountParts>,
    /// Rise and fall per second of the hidden chain.
    pub hidden_rates: [f64; 2],
    /// Expected numbers of readings: while the state is 1, and among these readings of 0; while the state is 0, and
    /// among these readings of 1.
    pub errors: [f64; 4],
    /// The probabilities of a miss and of a false alarm of the sensor.
    pub noise: [f64; 2],
    /// The log-likelihood that sensor noise has gained on readings before they were learned, in nats.
    pub gain: f64,
    /// Number of learned days.
    pub days: u32,
    /// Lengths in seconds of completed dwells at 0 and at 1, from which the survival is computed.
    pub dwells: [Vec<f32>; 2],
    /// The numbers of dwells of which `dwells` are selections.
    pub dwell_counts: [u32; 2],
    /// Lengths in seconds of the dwells that have ended since then.
    pub fresh_dwells: [Vec<f32>; 2],
    /// The dwell that has not ended.
    pub open: Option<OpenDwell>,
    /// The sums by lead time, from which the weights follow; empty before the first sum.
    pub lead_sums: Vec<f64>,
}

/// Counts of successive values at gaps of one octave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapCountParts {
    /// ⌊log₂⌋ of the gap in nanoseconds.
    pub octave: u32,
    /// Number of pairs, and the sum of the gaps of these pairs in seconds.
    pub pairs: [f64; 2],
    /// Numbers of pairs that stayed 0, rose, fell and stayed 1.
    pub counts: [f64; 4],
}

/// A dwell that has not ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenDwell {
    /// Whether the state is 1 in the dwell.
    pub is_one: bool,
    /// The time at which the dwell began, UTC nanoseconds, and the uncertainty of this time, in seconds; `None`: before
    /// the first reading.
    pub since: Option<(i64, f64)>,
    /// The time of the newest reading of the dwell, UTC nanoseconds.
    pub last_nanos: i64,
}

impl Belief {
    /// The parts to store.
    pub fn to_parts(&self) -> BeliefParts {
        let pair = |rates: Rates| [rates.rise_per_sec, rates.fall_per_sec];
        let ErrorSums { ones, misses, zeros, false_alarms } = self.errors;
        let of_value = &self.dwells.of_value;
        BeliefParts {
            has_two_values: self.has_two_values,
            newest: self.newest,
            recent: self.recent.spans().to_vec(),
            seen: counts_to_parts(&self.seen),
            seen_rates: pair(self.seen_rates),
            hidden: counts_to_parts(&self.hidden),
            hidden_rates: pair(self.hidden_rates),
            errors: [ones, misses, zeros, false_alarms],
            noise: [self.noise.miss, self.noise.false_alarm],
            gain: self.gain,
            days: self.days,
            dwells: of_value.each_ref().map(|of_value| of_value.secs.clone()),
            dwell_counts: of_value.each_ref().map(|of_value| of_value.count),
            fresh_dwells: of_value.each_ref().map(|of_value| of_value.fresh.clone()),
            open: self.dwells.open.map(|UnendedDwell { is_one, since, last_nanos }| OpenDwell {
                is_one,
                since,
                last_nanos,
            }),
            lead_sums: self.weights.to_sums(),
        }
    }

    /// The belief of a state of this kind, from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts_of(kind: StateKind, parts: BeliefParts) -> Result<Belief, InvalidParts> {
        if let Some((_, value)) = parts.newest {
            InvalidParts::check("newest learned value", value, kind.bounds())?;
        }
        for error in parts.noise {
            InvalidParts::check("sensor noise", error, 0.0..=NOISE_MAX)?;
        }
        for sum in parts.errors {
            InvalidParts::check("expected readings", sum, 0.0..=f64::MAX)?;
        }
        InvalidParts::check("gain of sensor noise", parts.gain, f64::MIN..=f64::MAX)?;
        let [ones, misses, zeros, false_alarms] = parts.errors;
        let [miss, false_alarm] = parts.noise;
        let [low, high] = parts
            .dwells
            .into_iter()
            .zip(parts.fresh_dwells)
            .collect::<Vec<_>>()
            .try_into()
            .map_err(|_| InvalidParts::OutOfRange { field: "values with dwells", found: 0.0 })?;
        let of_value = [dwells(low, parts.dwell_counts[0])?, dwells(high, parts.dwell_counts[1])?];
        if let Some(OpenDwell { since: Some((_, secs)), .. }) = parts.open {
            InvalidParts::check("begin of a dwell", secs, 0.0..=f64::MAX)?;
        }
        let open = parts.open.map(|OpenDwell { is_one, since, last_nanos }| UnendedDwell { is_one, since, last_nanos });
        Ok(Belief {
            has_two_values: parts.has_two_values && kind == StateKind::Probability,
            // The record of the state contains the sensor.
            sensor: None,
            newest: parts.newest,
            recent: Recent::from_spans(&parts.recent)?,
            seen: counts_from_parts(&parts.seen)?,
            seen_rates: rates(parts.seen_rates)?,
            hidden: counts_from_parts(&parts.hidden)?,
            hidden_rates: rates(parts.hidden_rates)?,
            errors: ErrorSums { ones, misses, zeros, false_alarms },
            noise: SensorNoise { miss, false_alarm },
            gain: parts.gain,
            days: parts.days,
            dwells: Dwells::from_parts(of_value, open),
            weights: LeadTimeWeights::from_sums(&parts.lead_sums)?,
        })
    }
}

fn rates([rise_per_sec, fall_per_sec]: [f64; 2]) -> Result<Rates, InvalidParts> {
    for rate in [rise_per_sec, fall_per_sec] {
        InvalidParts::check("rate of a chain", rate, f64::MIN_POSITIVE..=1e12)?;
    }
    Ok(Rates { rise_per_sec, fall_per_sec })
}

fn dwells((secs, fresh): (Vec<f32>, Vec<f32>), count: u32) -> Result<OfValue, InvalidParts> {
    if secs.len() > DWELLS_MAX || secs.len() as u64 > u64::from(count) || (count > 0 && secs.is_empty()) {
        return Err(InvalidParts::OutOfRange { field: "number of dwells", found: secs.len() as f64 });
    }
    for &length in secs.iter().chain(&fresh) {
        InvalidParts::check("length of a dwell", f64::from(length), 0.0..=f64::from(f32::MAX))?;
    }
    Ok(OfValue { secs, count, fresh })
}

fn counts_to_parts(transitions: &Transitions) -> Vec<GapCountParts> {
    let parts = |(&octave, counts): (&i32, &GapCounts)| GapCountParts {
        // Between 0 and 63.
        octave: octave.unsigned_abs(),
        pairs: [counts.weight, counts.gap_secs_sum],
        counts: [counts.low, counts.rises, counts.falls, counts.high],
    };
    transitions.by_gap.iter().map(parts).collect()
}

fn counts_from_parts(parts: &[GapCountParts]) -> Result<Transitions, InvalidParts> {
    let mut transitions = Transitions::default();
    for &GapCountParts { octave, pairs: [weight, gap_secs_sum], counts: [low, rises, falls, high] } in parts {
        for count in [low, rises, falls, high] {
            InvalidParts::check("count of pairs", count, 0.0..=f64::MAX)?;
        }
        InvalidParts::check("number of pairs", weight, f64::MIN_POSITIVE..=f64::MAX)?;
        InvalidParts::check("sum of gaps", gap_secs_sum, f64::MIN_POSITIVE..=f64::MAX)?;
        let known = i32::try_from(octave).ok().filter(|octave| *octave < 64);
        let octave = known.ok_or(InvalidParts::OutOfRange { field: "octave of a gap", found: octave.into() })?;
        transitions.by_gap.insert(octave, GapCounts { weight, gap_secs_sum, low, rises, falls, high });
    }
    Ok(transitions)
}
