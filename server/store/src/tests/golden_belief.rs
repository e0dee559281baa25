//! The bytes of the stored data about a state's newest reading, and the bytes of such data that are refused.

use std::sync::Arc;

use prost::Message as _;
use tidemap_layout::map::State;
use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{Belief, Recent, RecentSpan, StateModel};

use super::{
    golden_ensemble::{read, written},
    golden_states::{alternatives, state},
    wire::{self, Message},
};
use crate::record::{fields, snapshot::encode_state};

fn message() -> Message {
    let octave = |octave, pairs, secs| [octave, pairs, secs, 3.0, 0.5, 0.25, 1.25];
    let newest = Message::default().signed(1, 1_700_000_000_000_000_000).double(2, 1.0);
    let numbers = [0.000_5, 0.002, 0.000_25, 0.001, 9.5, 0.75, 20.25, 1.5, 0.09, 0.125, 7.5];
    let low = Message::default().singles(1, &[600.0, 1200.5]).integer(2, 2).singles(3, &[300.0]);
    let high = Message::default().singles(1, &[90.25]).integer(2, 1);
    let open = Message::default().integer(1, 1).signed(2, 1_699_999_000_000_000_000).double(3, 60.0);
    let sums: Vec<f64> = (0..126_u8).map(|sum| f64::from(sum) / 4.0).collect();
    Message::default()
        .integer(1, 1)
        .bytes(2, newest)
        .bytes(3, fields::pack(&spans()))
        .doubles(4, &numbers)
        .doubles(5, &[octave(35.0, 5.0, 300.0), octave(40.0, 5.0, 6000.5)].concat())
        .doubles(6, &octave(35.0, 4.75, 285.0))
        .integer(7, 28)
        .bytes(8, low)
        .bytes(8, high)
        .bytes(9, open.signed(4, 1_700_000_000_000_000_000))
        .doubles(10, &sums)
}

fn belief() -> Belief {
    fields::read(Belief::new(true), &message().0).expect("valid")
}

fn spans() -> Vec<RecentSpan> {
    let span = |first_nanos, length_millis, ones, zeros| RecentSpan { first_nanos, length_millis, ones, zeros };
    vec![span(1_699_999_000_000_000_000, 60_500, 2, 7), span(1_700_000_000_000_000_000, 0, 1, 0)]
}

pub(super) fn known() -> StateSnapshot {
    let plain = state("door", alternatives(None));
    let model = StateModel::clone(&plain.model).with_belief(belief());
    StateSnapshot { model: Arc::new(model), recent: Recent::from_spans(&spans()).expect("valid"), ..plain }
}

#[test]
fn beliefs_are_written_as_they_always_were_and_come_back() {
    let state = known();
    let message = encode_state(0, &state, state.model.accumulator().to_parts());
    let bytes = State { belief: message.belief.clone(), recent: message.recent.clone(), ..State::default() };
    assert_eq!(crc32c::crc32c(&bytes.encode_to_vec()), 0x59CE_33D6, "a belief is written in another way");
    assert_eq!(message.belief, Some(self::message().0));
    assert_eq!(read(&message.encode_to_vec()), Ok(state));
}

#[test]
fn sums_of_the_newest_value_alone_are_read() {
    let of_length = |sums: u8| {
        let sums = (0..sums).flat_map(|sum| (f64::from(sum) / 4.0).to_le_bytes());
        let change = |content: &mut Vec<u8>| *content = sums.clone().collect();
        fields::read(Belief::new(true), &wire::changed(&message().0, &[10], Some(&change)))
    };
    // They hold no errors, so that nothing narrows an interval.
    let share = |read: Belief| read.error_share(0, false, 60_000_000_000);
    assert_eq!(of_length(18).map(share), Ok(1.0));
    assert_ne!(of_length(18), of_length(0), "the sums are used");
    assert!(of_length(17).is_err() && of_length(125).is_err());
}

#[test]
fn wrong_beliefs_are_refused() {
    let bytes = written(&known());
    let refused =
        |path: &[u32], change: &dyn Fn(&mut Vec<u8>)| read(&wire::changed(&bytes, path, Some(change))).is_err();
    let number = |tag: u32, at: usize, number: f64| {
        refused(&[20, tag], &|content| content[8 * at..8 * (at + 1)].copy_from_slice(&number.to_le_bytes()))
    };
    assert!(!number(4, 0, 1.0), "a rate");
    assert!(number(4, 0, 0.0) && number(4, 3, f64::INFINITY), "no rate");
    assert!(number(4, 4, -1.0) && number(4, 7, f64::NAN), "expected readings");
    assert!(number(4, 8, 0.5) && number(4, 9, -0.1), "sensor noise");
    assert!(number(4, 10, f64::NAN), "a gain");
    assert!(number(5, 0, 64.0) && number(5, 0, -1.0) && number(6, 0, f64::NAN), "an octave");
    assert!(number(5, 1, 0.0) && number(5, 2, -1.0) && number(5, 6, -1.0), "counts of pairs");
    assert!(number(10, 9, -1.0) && !number(10, 8, -1.0), "sums of squares");
    assert!(refused(&[20, 4], &|content| content.truncate(80)));
    assert!(refused(&[20, 5], &|content| content.truncate(8)));
    assert!(refused(&[20, 8, 2], &|content| *content = vec![0]), "dwells that are more than their number");
    assert!(refused(&[20, 2, 2], &|content| *content = 2.0_f64.to_le_bytes().to_vec()), "no probability");
    assert!(refused(&[20, 3], &|content| content.truncate(15)));
    assert!(refused(&[21], &|content| content.truncate(17)));
    assert!(!refused(&[21], &|_| ()));
}
