//! The bytes of categorical states, in the log and in checkpoints, and what of them is refused.

use prost::Message as _;
use tidemap_layout::{event::NewState as NewStateRecord, map::State};
use tidemap_map::{
    event::{Event, NewState, StateKind},
    ids::StateId,
    name::StateName,
    site::Site,
    snapshot::StateSnapshot,
};

use super::golden_states::{alternatives, spec, state};
use crate::record::{
    self, event,
    snapshot::{SpectrumIn, decode_state, encode_state},
};

pub(super) fn categorical() -> NewState {
    let name = StateName::new("activity").expect("valid");
    let labels = ["sleep", "eat"].map(|label| name.label(label).expect("valid")).to_vec();
    NewState::categorical(StateId(3), name, labels).expect("two labels")
}

#[test]
fn labels_in_the_log_are_written_as_they_always_were_and_come_back() {
    let added = Event::AddState(categorical());
    let (kind, payload) = event::encode(&added).expect("valid");
    assert_eq!(crc32c::crc32c(&payload), 0x3213_96CC, "labels are written in another way");
    assert_eq!(event::decode(kind, &payload), Ok(added));
    let message = NewStateRecord::decode(&payload[..]).expect("a message");
    let is_read = |message: NewStateRecord| event::decode(kind, &message.encode_to_vec()).is_ok();
    let labels = |labels: &[&str]| labels.iter().map(|label| (*label).to_owned()).collect();
    for wrong in [&["sleep"][..], &[], &["sleep", "sleep"], &["sleep", "x"], &["sleep", "a/b"]] {
        assert!(!is_read(NewStateRecord { labels: labels(wrong), ..message.clone() }), "{wrong:?}");
    }
    let many: Vec<String> = (0..65).map(|label| label.to_string()).collect();
    assert!(is_read(NewStateRecord { labels: many[..64].to_vec(), ..message.clone() }));
    assert!(!is_read(NewStateRecord { labels: many, ..message.clone() }));
    assert!(!is_read(NewStateRecord { kind: 0, ..message.clone() }), "no other kind has labels");
    assert!(!is_read(NewStateRecord { name: "activity/sleep".to_owned(), ..message }));
}

pub(super) fn label(name: &str) -> StateSnapshot {
    StateSnapshot {
        name: StateName::labelled(name).expect("valid"),
        kind: StateKind::Probability,
        ..state("a", alternatives(None))
    }
}

#[test]
fn a_label_in_a_checkpoint_is_a_kind_of_its_own() {
    let sleep = label("activity/sleep");
    let saved = encode_state(0, &sleep, sleep.model.accumulator().to_parts());
    assert_eq!((saved.name.as_str(), saved.kind), ("activity/sleep", 3));
    let read = |message: &State| decode_state(0, message, &spec().periodicities, SpectrumIn::Checkpoint);
    let found = read(&saved).expect("valid");
    assert_eq!(found, sleep);
    assert!(read(&State { kind: 0, ..saved.clone() }).is_err(), "a probability has no slash in its name");
    assert!(read(&State { name: "activity".to_owned(), ..saved.clone() }).is_err());
    assert!(read(&State { name: "activity/x".to_owned(), ..saved }).is_err());
}

#[test]
fn a_snapshot_has_whole_categorical_states_or_is_not_believed() {
    let is_sound = |states: Vec<StateSnapshot>| {
        let message = tidemap_layout::map::Snapshot { states: states.len() as u32, ..Default::default() };
        record::snapshot::decode(&message, Vec::new(), states, Site::default()).is_ok()
    };
    let of_names = |names: &[&str]| {
        let state = |name: &&str| match name.contains('/') {
            true => label(name),
            false => StateSnapshot { name: StateName::new(name).expect("valid"), ..label("a/b") },
        };
        is_sound(names.iter().map(state).collect())
    };
    for names in [&["a/b", "a/c"][..], &["d", "a/b", "a/c", "e/b", "e/c", "e/f"], &["d"]] {
        assert!(of_names(names), "{names:?}");
    }
    for names in [&["a/b"][..], &["a/b", "d", "a/c"], &["a/b", "a/c", "d", "a/e", "a/f"], &["a/b", "a/c", "a"]] {
        assert!(!of_names(names), "{names:?}");
    }
    let count = StateSnapshot { kind: StateKind::Count, ..label("a/c") };
    assert!(!is_sound(vec![label("a/b"), count]), "a label is a probability");
}
