//! The bytes of the ensemble of a state that is no probability, and what of them is refused.

use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{Alternatives, NumberEnsemble, StateKind};

use super::{
    golden_ensemble::{read, written},
    golden_states::{alternatives, state_of},
    wire::{self, Message},
};
use crate::record::fields;

/// Number of numbers in an ensemble.
const NUMBERS: u16 = 2079;

/// The path of tags from a state to its ensemble.
const PATH: [u32; 2] = [14, 21];

fn message() -> Message {
    let numbers: Vec<f64> = (0..NUMBERS).map(|number| f64::from(number) / 4.0).collect();
    let seen: Vec<u8> = (0..14_u64).flat_map(|day| ((1 << 47) | day).to_le_bytes()).collect();
    let message = Message::default().signed(1, 20_340).doubles(2, &numbers).bytes(3, seen);
    let turns: [&[i64]; 4] = [&[20_340, 20_338], &[20_336, 20_329], &[20_332, 20_304], &[20_301]];
    turns.iter().fold(message, |message, days| message.bytes(4, Message::default().days(1, days))).bytes(4, [])
}

pub(super) fn known() -> StateSnapshot {
    let mut parts = alternatives(None).to_parts();
    parts.numbers = Some(Box::new(fields::read(NumberEnsemble::default(), &message().0).expect("valid")));
    let known = Alternatives::from_parts_of(StateKind::Continuous, parts).expect("valid");
    state_of(StateKind::Continuous, "temperature", known)
}

#[test]
fn ensembles_of_numbers_are_written_as_they_always_were_and_come_back() {
    let state = known();
    let bytes = written(&state);
    let numbers = wire::content(&bytes, &PATH).expect("an ensemble");
    let found = crc32c::crc32c(&numbers);
    assert_eq!(found, 0x074D_C95A, "an ensemble is written in another way: {found:#X}");
    assert_eq!(numbers, message().0);
    assert_eq!(read(&bytes), Ok(state));
}

#[test]
fn wrong_ensembles_of_numbers_are_refused() {
    let bytes = written(&known());
    let refused = |tag: u32, change: &dyn Fn(&mut Vec<u8>)| {
        read(&wire::changed(&bytes, &[PATH[0], PATH[1], tag], Some(change))).is_err()
    };
    let number = |at: usize, number: f64| {
        refused(2, &|content| content[8 * at..8 * (at + 1)].copy_from_slice(&number.to_le_bytes()))
    };
    assert!(!number(1, 1.0) && !number(2, -1.0));
    assert!(number(1, -1.0) && number(2, f64::NAN) && number(usize::from(NUMBERS) - 1, f64::INFINITY));
    assert!(refused(2, &|content| content.truncate(8)));
    assert!(refused(3, &|content| content.truncate(2 * 8)));
    let turns = |days: &[i64]| refused(4, &|content| *content = Message::default().days(1, days).0);
    assert!(!turns(&[9, 3]) && !turns(&[9]) && !turns(&[]));
    assert!(turns(&[3, 9]) && turns(&[9, 9]) && turns(&[9, 3, 1]));
    let without_day = wire::changed(&bytes, &[PATH[0], PATH[1], 1], None);
    assert!(read(&without_day).is_err(), "bins of no day");
}
