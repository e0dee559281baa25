//! The bytes of how a state is reported, in the log and in checkpoints, and what of them is refused.

use std::sync::Arc;

use prost::Message as _;
use tidemap_layout::{
    event::NewState as NewStateRecord,
    map::State,
    rows::{Reporting as ReportingRecord, Rows},
};
use tidemap_map::{
    event::{Event, Hold, NewState, Reporting, StateKind, StateShape},
    ids::{ProducerId, StateId},
    live_state::NewestRow,
    name::StateName,
    snapshot::StateSnapshot,
};
use tidemap_model::{LearnedRows, StateModel};

use super::golden_states::{alternatives, spec, state};
use crate::record::{
    event,
    snapshot::{SpectrumIn, decode_state, encode_state},
};

fn reporting() -> Reporting {
    Reporting::Changes(Hold::new(86_400, 60).expect("a hold"))
}

pub(super) fn known() -> StateSnapshot {
    let plain = state("door", alternatives(None));
    let learned = LearnedRows {
        rows: 12,
        first_nanos: Some(1_700_000_040_000_000_000),
        next_nanos: 1_700_000_100_000_000_000,
        newest: Some((1_700_000_090_000_000_000, None)),
        open_events: Some(2.0),
        waiting: Arc::default(),
    };
    let newest_row = NewestRow {
        nanos: 1_700_000_095_000_000_000,
        has_value: true,
        is_live: true,
        producer: ProducerId(3),
        events: 0.5,
    };
    let model = StateModel::clone(&plain.model).with_reporting(reporting(), learned);
    StateSnapshot { model: Arc::new(model), newest_row: Some(newest_row), ..plain }
}

#[test]
fn rows_in_checkpoints_are_written_as_they_always_were_and_come_back() {
    let state = known();
    let message = encode_state(0, &state, state.model.accumulator().to_parts());
    let bytes = State { rows: message.rows.clone(), ..State::default() };
    assert_eq!(crc32c::crc32c(&bytes.encode_to_vec()), 0xBBF8_1179, "rows are written in another way");
    let again = decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint);
    assert_eq!(again, Ok(state));
    let rows = message.rows.clone().expect("rows");
    let other = |reporting| State { rows: Some(Rows { reporting, ..rows.clone() }), ..message.clone() };
    for (kind, max_secs, step_secs) in [(1, 59, 60), (1, 60, 0), (3, 86_400, 60), (2, 86_400, 60)] {
        let wrong = other(Some(ReportingRecord { kind, max_secs, step_secs }));
        assert!(decode_state(0, &wrong, &spec().periodicities, SpectrumIn::Checkpoint).is_err(), "{kind} {max_secs}");
    }
    let infinite = Rows { open_events_bits: Some(f64::INFINITY.to_bits()), ..rows };
    let wrong = State { rows: Some(infinite), ..message };
    assert!(decode_state(0, &wrong, &spec().periodicities, SpectrumIn::Checkpoint).is_err());
}

#[test]
fn rows_that_wait_come_back_in_order_of_time() {
    let state = known();
    let (reporting, learned) = (state.model.reporting(), state.model.learned_rows().expect("rows").clone());
    let waiting = [(1_700_000_100_000_000_000, Some(0.0)), (1_700_000_160_000_000_000, None)];
    let learned = LearnedRows { waiting: waiting.into(), ..learned };
    let model = StateModel::clone(&state.model).with_reporting(reporting, learned);
    let state = StateSnapshot { model: Arc::new(model), ..state };
    let message = encode_state(0, &state, state.model.accumulator().to_parts());
    assert_eq!(decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint), Ok(state));
    let mut wrong = message.clone();
    wrong.rows.as_mut().expect("rows").waiting.reverse();
    assert!(decode_state(0, &wrong, &spec().periodicities, SpectrumIn::Checkpoint).is_err(), "not in order");
    let mut wrong = message;
    wrong.rows.as_mut().expect("rows").waiting[0].value_bits = Some(f64::NAN.to_bits());
    assert!(decode_state(0, &wrong, &spec().periodicities, SpectrumIn::Checkpoint).is_err(), "no number");
}

#[test]
fn reports_in_the_log_are_written_as_they_always_were_and_come_back() {
    let name = StateName::new("door").expect("valid");
    let new = NewState { reporting: reporting(), ..NewState::sampled(StateId(3), name, StateShape::default()) };
    let added = Event::AddState(new);
    let (kind, payload) = event::encode(&added).expect("valid");
    assert_eq!(crc32c::crc32c(&payload), 0x9DF9_C168, "a way to report is written in another way");
    assert_eq!(event::decode(kind, &payload), Ok(added));
    let message = NewStateRecord::decode(&payload[..]).expect("a message");
    let events = ReportingRecord { kind: 2, max_secs: 7_200, step_secs: 3_600 };
    let wrong = NewStateRecord { reporting: Some(events), ..message.clone() };
    assert!(event::decode(kind, &wrong.encode_to_vec()).is_err(), "only counts have events");
    let count = NewStateRecord { kind: StateKind::ALL.len() as u32 - 1, reporting: Some(events), ..message };
    assert!(event::decode(kind, &count.encode_to_vec()).is_ok());
}
