//! The bytes of the stored data about a state's newest reading, and the bytes of such data that are refused.

use std::sync::Arc;

use prost::Message as _;
use tidemap_layout::map::State;
use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{Belief, BeliefParts, GapCountParts, OpenDwell, Recent, RecentSpan, StateKind, StateModel};

use super::golden_states::{alternatives, spec, state};
use crate::record::snapshot::{SpectrumIn, decode_state, encode_state};

fn belief() -> Belief {
    let octave = |octave, pairs| GapCountParts { octave, pairs, counts: [3.0, 0.5, 0.25, 1.25] };
    let spans = spans();
    let parts = BeliefParts {
        has_two_values: true,
        newest: Some((1_700_000_000_000_000_000, 1.0)),
        recent: spans,
        seen: vec![octave(35, [5.0, 300.0]), octave(40, [5.0, 6000.5])],
        seen_rates: [0.000_5, 0.002],
        hidden: vec![octave(35, [4.75, 285.0])],
        hidden_rates: [0.000_25, 0.001],
        errors: [9.5, 0.75, 20.25, 1.5],
        noise: [0.09, 0.125],
        gain: 7.5,
        days: 28,
        dwells: [vec![600.0, 1200.5], vec![90.25]],
        dwell_counts: [2, 1],
        fresh_dwells: [vec![300.0], Vec::new()],
        open: Some(OpenDwell {
            is_one: true,
            since: Some((1_699_999_000_000_000_000, 60.0)),
            last_nanos: 1_700_000_000_000_000_000,
        }),
        lead_sums: (0..18_u8).map(|sum| f64::from(sum) / 4.0).collect(),
    };
    Belief::from_parts_of(StateKind::Probability, parts).expect("valid")
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
    assert_eq!(crc32c::crc32c(&bytes.encode_to_vec()), 0xDC7B_FBBA, "a belief is written in another way");
    let again = decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint);
    assert_eq!(again, Ok(state));
}

#[test]
fn wrong_beliefs_are_refused() {
    let state = known();
    let whole = encode_state(0, &state, state.model.accumulator().to_parts());
    let refused = |change: &dyn Fn(&mut State)| {
        let mut message = whole.clone();
        change(&mut message);
        decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint).is_err()
    };
    let changes: [&dyn Fn(&mut tidemap_layout::map::Belief); 5] = [
        &|belief| belief.numbers.truncate(80),
        &|belief| belief.dwells.truncate(1),
        &|belief| belief.seen.truncate(8),
        &|belief| belief.lead_sums.truncate(8),
        &|belief| belief.recent.truncate(15),
    ];
    for (number, change) in changes.into_iter().enumerate() {
        assert!(refused(&|message| message.belief.iter_mut().for_each(change)), "change {number}");
    }
    assert!(refused(&|message| message.recent.truncate(17)));
    assert!(!refused(&|_| ()));
}
