//! The bytes of the ensemble of a probability,. `golden_refusals.rs` has what of them is refused.

use prost::Message as _;
use tidemap_layout::map::State;
use tidemap_map::snapshot::StateSnapshot;
use tidemap_model::{
    Alternatives, Ensemble, LocalDay, Sample,
    models::{Mean, Readings},
};

use super::{
    golden_states::{alternatives, spec, state},
    wire,
};
use crate::record::snapshot::{SpectrumIn, decode_state, encode_state};

/// The path of tags from a state to its ensemble.
pub(super) const PATH: [u32; 2] = [14, 20];

/// An ensemble of a door that is open by day, on most days, and observed in every half-hour of some days.
fn ensemble(days: i64) -> Ensemble {
    let mut ensemble = Ensemble::new();
    for day in 0..days {
        let sample = |slot: i64| Sample {
            utc_nanos: (day * 48 + slot) * 1_800_000_000_000,
            offset_secs: 0,
            value: f64::from(u8::from((18..36).contains(&slot) && day % 7 < 5 && day % 11 != 3)),
        };
        let samples: Vec<Sample> = (0..48).map(sample).collect();
        let mean = Mean::train(Readings::new(&samples)).expect("readings");
        ensemble.learn_day(LocalDay(i32::try_from(day).expect("few")), &samples, &samples, &mean);
    }
    ensemble
}

pub(super) fn known(days: i64) -> StateSnapshot {
    let mut parts = alternatives(None).to_parts();
    parts.ensemble = Some(Box::new(ensemble(days)));
    state("door", Alternatives::from_parts(parts).expect("valid"))
}

pub(super) fn written(state: &StateSnapshot) -> Vec<u8> {
    encode_state(0, state, state.model.accumulator().to_parts()).encode_to_vec()
}

pub(super) fn read(bytes: &[u8]) -> Result<StateSnapshot, String> {
    let message = State::decode(bytes).map_err(|error| error.to_string())?;
    decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint)
}

#[test]
fn ensembles_are_written_as_they_always_were_and_come_back() {
    let written_crc = |days| {
        let state = known(days);
        let bytes = written(&state);
        assert_eq!(read(&bytes), Ok(state));
        let ensemble = wire::content(&bytes, &PATH).expect("an ensemble");
        assert!(ensemble.len() < 24_000, "{} bytes after {days} days", ensemble.len());
        crc32c::crc32c(&ensemble)
    };
    let found = [0, 1, 9, 400].map(written_crc);
    assert_eq!(
        found,
        [0x8689_CDA4, 0xE4FA_51A6, 0x99CF_2B9B, 0xF4A7_A386],
        "ensembles are written in another way: {found:#X?}"
    );
}
