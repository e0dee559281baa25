//! The learned data for short-term forecasts of a state, and its recent readings, as messages, and back.
//!
//! Invariant: every number is read back bit by bit; a value that is read has passed the constructors of the model.

use tidemap_layout::map as layout;
use tidemap_model::{Belief, BeliefParts, GapCountParts, OpenDwell, Recent, RecentSpan, StateKind};

use super::{Invalid, doubles};

/// Bytes of a span.
const SPAN: usize = 16;
/// Number of doubles in [`layout::Belief::numbers`], and in an octave of gaps.
const NUMBERS: usize = 11;
const OCTAVE: usize = 7;

pub(crate) fn encode_recent(spans: &[RecentSpan]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(spans.len() * SPAN);
    for span in spans {
        bytes.extend(span.first_nanos.to_le_bytes());
        bytes.extend(span.length_millis.to_le_bytes());
        bytes.extend(span.ones.to_le_bytes());
        bytes.extend(span.zeros.to_le_bytes());
    }
    bytes
}

fn decode_spans(bytes: &[u8]) -> Result<Vec<RecentSpan>, Invalid> {
    let (spans, rest) = bytes.as_chunks::<SPAN>();
    if !rest.is_empty() {
        return Err("the recent readings of a state do not have their length");
    }
    let span = |&[a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p]: &[u8; SPAN]| RecentSpan {
        first_nanos: i64::from_le_bytes([a, b, c, d, e, f, g, h]),
        length_millis: u32::from_le_bytes([i, j, k, l]),
        ones: u16::from_le_bytes([m, n]),
        zeros: u16::from_le_bytes([o, p]),
    };
    Ok(spans.iter().map(span).collect())
}

pub(crate) fn decode_recent(bytes: &[u8]) -> Result<Recent, String> {
    Recent::from_spans(&decode_spans(bytes)?).map_err(|error| error.to_string())
}

pub(crate) fn encode(belief: &Belief) -> layout::Belief {
    let parts = belief.to_parts();
    let mut numbers = Vec::with_capacity(NUMBERS * 8);
    doubles::push(&mut numbers, &parts.seen_rates);
    doubles::push(&mut numbers, &parts.hidden_rates);
    doubles::push(&mut numbers, &parts.errors);
    doubles::push(&mut numbers, &parts.noise);
    doubles::push(&mut numbers, &[parts.gain]);
    let mut lead_sums = Vec::with_capacity(parts.lead_sums.len() * 8);
    doubles::push(&mut lead_sums, &parts.lead_sums);
    let dwells = parts.dwells.into_iter().zip(parts.dwell_counts).zip(parts.fresh_dwells);
    layout::Belief {
        has_two_values: parts.has_two_values,
        newest: parts.newest.map(|(nanos, value)| layout::LastObservation { nanos, value_bits: value.to_bits() }),
        recent: encode_recent(&parts.recent),
        numbers,
        seen: encode_octaves(&parts.seen),
        hidden: encode_octaves(&parts.hidden),
        days: parts.days,
        dwells: dwells.map(|((secs, count), fresh)| layout::BeliefDwells { secs, count, fresh }).collect(),
        open: parts.open.map(|open| layout::OpenDwell {
            is_one: open.is_one,
            since_nanos: open.since.map(|(nanos, _)| nanos),
            since_secs_bits: open.since.map_or(0, |(_, secs)| secs.to_bits()),
            last_nanos: open.last_nanos,
        }),
        lead_sums,
    }
}

pub(crate) fn decode(kind: StateKind, message: &layout::Belief) -> Result<Belief, String> {
    let mut numbers = Vec::new();
    doubles::take(&message.numbers, &mut numbers);
    let [rise, fall, hidden_rise, hidden_fall, ones, misses, zeros, false_alarms, miss, false_alarm, gain] =
        *numbers.as_slice()
    else {
        return Err("the belief of a state does not have eleven numbers".to_owned());
    };
    let [low, high] = message.dwells.as_slice() else {
        return Err("a state does not have the dwells of two values".to_owned());
    };
    let mut lead_sums = Vec::new();
    doubles::take(&message.lead_sums, &mut lead_sums);
    let parts = BeliefParts {
        has_two_values: message.has_two_values,
        newest: message.newest.as_ref().map(|newest| (newest.nanos, f64::from_bits(newest.value_bits))),
        recent: decode_spans(&message.recent)?,
        seen: decode_octaves(&message.seen)?,
        seen_rates: [rise, fall],
        hidden: decode_octaves(&message.hidden)?,
        hidden_rates: [hidden_rise, hidden_fall],
        errors: [ones, misses, zeros, false_alarms],
        noise: [miss, false_alarm],
        gain,
        days: message.days,
        dwells: [low.secs.clone(), high.secs.clone()],
        dwell_counts: [low.count, high.count],
        fresh_dwells: [low.fresh.clone(), high.fresh.clone()],
        open: message.open.as_ref().map(|open| OpenDwell {
            is_one: open.is_one,
            since: open.since_nanos.map(|nanos| (nanos, f64::from_bits(open.since_secs_bits))),
            last_nanos: open.last_nanos,
        }),
        lead_sums,
    };
    Belief::from_parts_of(kind, parts).map_err(|error| error.to_string())
}

fn encode_octaves(octaves: &[GapCountParts]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(octaves.len() * OCTAVE * 8);
    for GapCountParts { octave, pairs, counts } in octaves {
        doubles::push(&mut bytes, &[f64::from(*octave)]);
        doubles::push(&mut bytes, pairs);
        doubles::push(&mut bytes, counts);
    }
    bytes
}

fn decode_octaves(bytes: &[u8]) -> Result<Vec<GapCountParts>, Invalid> {
    let mut numbers = Vec::new();
    doubles::take(bytes, &mut numbers);
    let (octaves, rest) = numbers.as_chunks::<OCTAVE>();
    if !rest.is_empty() {
        return Err("the gaps between the readings of a state do not have their length");
    }
    let octave = |&[octave, pairs, secs, low, rises, falls, high]: &[f64; OCTAVE]| GapCountParts {
        // The model checks this: a number that is no octave becomes an octave that is out of range, or 0.
        octave: octave as u32,
        pairs: [pairs, secs],
        counts: [low, rises, falls, high],
    };
    Ok(octaves.iter().map(octave).collect())
}
