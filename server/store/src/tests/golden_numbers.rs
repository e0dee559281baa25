//! The bytes of the ensemble of a state that is no probability, and what of them is refused.

use prost::Message as _;
use tidemap_layout::{ensemble::NumberEnsemble, map::State};
use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{Alternatives, LocalDay, NumberEnsembleParts, StateKind};

use super::golden_states::{alternatives, spec, state_of};
use crate::record::snapshot::{SpectrumIn, decode_state, encode_state};

/// Number of numbers in an ensemble.
const NUMBERS: u16 = 2079;

pub(super) fn known() -> StateSnapshot {
    let day = |day| LocalDay(20_300 + day);
    let numbers = NumberEnsembleParts {
        last_day: Some(day(40)),
        numbers: (0..NUMBERS).map(|number| f64::from(number) / 4.0).collect(),
        seen: (0..14_u64).map(|day| (1 << 47) | day).collect(),
        kept_days: vec![vec![day(40), day(38)], vec![day(36), day(29)], vec![day(32), day(4)], vec![day(1)], vec![]],
    };
    let mut parts = alternatives(None).to_parts();
    parts.numbers = Some(Box::new(numbers));
    let known = Alternatives::from_parts_of(StateKind::Continuous, parts).expect("valid");
    state_of(StateKind::Continuous, "temperature", known)
}

#[test]
fn ensembles_of_numbers_are_written_as_they_always_were_and_come_back() {
    let state = known();
    let message = encode_state(0, &state, state.model.accumulator().to_parts());
    let numbers = message.alternatives.as_ref().and_then(|known| known.numbers.clone()).expect("an ensemble");
    let found = crc32c::crc32c(&numbers.encode_to_vec());
    assert_eq!(found, 0x074D_C95A, "an ensemble is written in another way: {found:#X}");
    let again = decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint);
    assert_eq!(again, Ok(state));
}

#[test]
fn wrong_ensembles_of_numbers_are_refused() {
    let state = known();
    let whole = encode_state(0, &state, state.model.accumulator().to_parts());
    let refused = |change: &dyn Fn(&mut NumberEnsemble)| {
        let mut message: State = whole.clone();
        let known = message.alternatives.as_mut().and_then(|known| known.numbers.as_deref_mut());
        known.into_iter().for_each(change);
        decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint).is_err()
    };
    assert!(!refused(&|_| ()));
    assert!(refused(&|known| known.numbers.truncate(8)));
    assert!(refused(&|known| known.numbers.truncate(8 * usize::from(NUMBERS) - 1)));
    assert!(refused(&|known| known.numbers.extend([0; 8])));
    assert!(refused(&|known| known.seen.truncate(2)));
    assert!(refused(&|known| known.turns.truncate(2)));
    assert!(refused(&|known| known.turns.iter_mut().for_each(|turns| turns.days.push(3))));
}
