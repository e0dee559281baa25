//! The reporting of a state and the stored data of its rows, as messages, and back.
//!
//! Invariant: a state whose rows are readings has no message. Durations that are read are valid for the state.

use std::sync::Arc;

use tidemap_layout::rows as layout;
use tidemap_map::{
    event::{Hold, Reporting, StateShape},
    ids::ProducerId,
    live_state::NewestRow,
};
use tidemap_model::{LearnedRows, Row, StateModel};

use super::Invalid;

const CHANGES: u32 = 1;
const EVENTS: u32 = 2;

/// The message; `None` for samples.
pub(super) fn encode_reporting(reporting: Reporting) -> Option<layout::Reporting> {
    let (kind, hold) = match reporting {
        Reporting::Samples => return None,
        Reporting::Changes(hold) => (CHANGES, hold),
        Reporting::Events(hold) => (EVENTS, hold),
    };
    Some(layout::Reporting { kind, max_secs: hold.max_secs(), step_secs: hold.step_secs() })
}

/// The reporting of a message, which a state of this shape may have.
pub(super) fn decode_reporting(message: Option<&layout::Reporting>, shape: StateShape) -> Result<Reporting, Invalid> {
    let Some(message) = message else { return Ok(Reporting::Samples) };
    let hold =
        Hold::new(message.max_secs, message.step_secs).map_err(|_| "a state holds its values for no duration")?;
    let reporting = match message.kind {
        CHANGES => Reporting::Changes(hold),
        EVENTS => Reporting::Events(hold),
        _ => return Err("a state is reported in an unknown way"),
    };
    if shape.may_report(reporting) { Ok(reporting) } else { Err("a state is reported as its kind cannot be") }
}

fn encode_row((nanos, value): Row) -> layout::Row {
    layout::Row { nanos, value_bits: value.map(f64::to_bits) }
}

fn decode_row(message: layout::Row) -> Row {
    (message.nanos, message.value_bits.map(f64::from_bits))
}

/// The message of the rows of a state; `None` for a state that reports samples.
pub(super) fn encode(model: &StateModel, newest: Option<NewestRow>) -> Option<layout::Rows> {
    let learned = model.learned_rows()?;
    Some(layout::Rows {
        reporting: encode_reporting(model.reporting()),
        learned: learned.rows,
        first_nanos: learned.first_nanos,
        next_nanos: learned.next_nanos,
        newest_learned: learned.newest.map(encode_row),
        open_events_bits: learned.open_events.map(f64::to_bits),
        newest: newest.map(|newest| layout::NewestRow {
            nanos: newest.nanos,
            has_value: newest.has_value,
            is_live: newest.is_live,
            producer: newest.producer.0,
            events_bits: newest.events.to_bits(),
        }),
        waiting: learned.waiting.iter().copied().map(encode_row).collect(),
    })
}

/// The newest row that arrived.
pub(super) fn decode_newest(message: Option<&layout::Rows>) -> Result<Option<NewestRow>, Invalid> {
    let Some(newest) = message.and_then(|rows| rows.newest) else { return Ok(None) };
    let events = f64::from_bits(newest.events_bits);
    if !events.is_finite() {
        return Err("a state has no number of events");
    }
    let layout::NewestRow { nanos, has_value, is_live, producer, .. } = newest;
    Ok(Some(NewestRow { nanos, has_value, is_live, producer: ProducerId(producer), events }))
}

/// The model, with the reporting and the learned rows of the message.
pub(super) fn decode(model: StateModel, message: Option<&layout::Rows>) -> Result<StateModel, Invalid> {
    let Some(rows) = message else { return Ok(model) };
    let reporting = decode_reporting(rows.reporting.as_ref(), StateShape::Scalar(model.kind()))?;
    let newest = rows.newest_learned.map(decode_row);
    let open_events = rows.open_events_bits.map(f64::from_bits);
    let waiting: Arc<[Row]> = rows.waiting.iter().copied().map(decode_row).collect();
    if !waiting.is_sorted_by_key(|(nanos, _)| *nanos) {
        return Err("the rows of a state that wait are not in order of time");
    }
    let known = newest.iter().chain(waiting.iter()).filter_map(|(_, value)| *value);
    if known.chain(open_events).any(|value| !value.is_finite()) {
        return Err("a row of a state has no number");
    }
    let layout::Rows { learned, first_nanos, next_nanos, .. } = *rows;
    let learned = LearnedRows { rows: learned, first_nanos, next_nanos, newest, open_events, waiting };
    Ok(model.with_reporting(reporting, learned))
}
