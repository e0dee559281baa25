//! Erasures of some of the observations of a map that has learned them, cut off at every step.

use std::sync::atomic::AtomicU64;

use tidemap_grid::spec::Retention;
use tidemap_map::{
    erasure::{NotErasable, Selection},
    event::{Envelope, NewState, Observations, OffsetRun, SequenceSpan, UpdateCause},
    ids::ProducerId,
    live_map::LiveMap,
    name::{ProducerKey, StateName},
    training::{ReadingsRequest, StateReadings},
};
use tidemap_model::StateKind;

use super::*;
use crate::{Erased, StateFiles};

const HOUR: i64 = 3_600_000_000_000;
const DAYS: i64 = 9;
const STATES: u32 = 3;

#[derive(Debug)]
struct Files(StateFiles);

impl StateReadings for Files {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        self.0.readings(wanted).map_err(|error| error.to_string())
    }
}

/// The observations of a producer in a half day, without the selected ones.
fn observed(half_day: i64, without: &Selection) -> Event {
    let producer = ProducerId(u32::try_from(half_day % 2).expect("small"));
    let all = (0..12).flat_map(|hour| (0..STATES).map(move |state| (StateId(state), half_day * 12 + hour)));
    // A few belong to the next day, and are learned with it.
    let rows = all.map(|(state, hour)| (state, hour * HOUR + HOUR / 2 * i64::from(state.0) * (half_day % 3)));
    let left: Vec<_> = rows.filter(|(state, nanos)| !without.takes(*state, producer, *nanos)).collect();
    let number = half_day / 2;
    let key = ProducerKey::new(&format!("robot-{}", producer.0), "").expect("valid");
    let count = u32::try_from(left.len()).expect("few");
    let new =
        |id| NewState::sampled(StateId(id), StateName::new(&format!("s{id}")).expect("valid"), StateKind::Probability);
    Event::Observations(
        Envelope {
            producer,
            new_producer: (number == 0).then(|| key.into()),
            incarnation: 1,
            span: SequenceSpan {
                first: u64::try_from(number).expect("small") * 36 + 1,
                last: u64::try_from(number).expect("small") * 36 + 36,
                content_crc: 7,
            },
            received_nanos: 1000 * HOUR,
            refused: Vec::new(),
        },
        Observations {
            new_states: if half_day == 0 { (0..STATES).map(new).collect() } else { Vec::new() },
            states: left.iter().map(|(state, _)| *state).collect(),
            times_nanos: left.iter().map(|(_, nanos)| *nanos).collect(),
            values: left
                .iter()
                .map(|(state, at)| f64::from(u8::from((at / HOUR / 7 + i64::from(state.0)) % 2 == 0)))
                .collect(),
            offsets: if count > 0 { vec![OffsetRun { count, offset_secs: 3600 }] } else { Vec::new() },
            failures: Vec::new(),
            runs: Vec::new(),
        },
    )
}

/// A disk with a map that got all events without the selected observations; the last days are in the log only.
fn disk_without(spec: &MapSpec, without: &Selection) -> SimulatedDisk {
    let disk = SimulatedDisk::new(SmallRng::seed_from_u64(5));
    make_directory(&disk);
    let committer = Arc::default();
    let store = started(&disk, &committer).expect("starts");
    store.create_map(spec).expect("creates");
    let log = store.open_map(MAP, spec).expect("opens").log;
    let mut map = LiveMap::new(Arc::new(spec.clone()));
    for day in 0..DAYS {
        let update = |map: &LiveMap| {
            let mut start = map.plan_update(Some((day + 1) * 24 * HOUR), 1000 * HOUR, UpdateCause::Midnight);
            start.cut_nanos = (day + 1) * 24 * HOUR;
            Event::UpdateStart(start)
        };
        for part in 0..3 {
            if part == 2 && day + 2 > DAYS {
                continue;
            }
            let event = if part == 2 { update(&map) } else { observed(2 * day + part, without) };
            log.append(&event, Box::new(|done| assert!(done.is_ok()))).expect("queued");
            committer.commit(committer.take_now());
            if let Some(work) = map.apply(map.position() + 1, &event).expect("consistent") {
                let files = store.history(MAP).expect("known").before(work.start().generation).state_files();
                let work = work.with_readings(Arc::new(Files(files.expect("readable"))));
                let snapshot = map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
                store.save(MAP, &snapshot).expect("saves");
            }
        }
    }
    drop((store, log));
    disk.kill()
}

fn comparable(mut content: Content) -> Content {
    // Less may be pending.
    content.snapshot.replay_from = 0;
    content.events.retain(|(position, _)| *position > content.snapshot.position);
    content
}

fn nothing() -> Selection {
    Selection { states: Some([StateId(99)].into()), producers: None, from_nanos: 0, to_nanos: i64::MAX }
}

fn select(states: Option<&[u32]>, producer: Option<u32>, hours: std::ops::Range<i64>) -> Selection {
    Selection {
        states: states.map(|states| states.iter().copied().map(StateId).collect()),
        producers: producer.map(|producer| [ProducerId(producer)].into()),
        from_nanos: hours.start * HOUR,
        to_nanos: hours.end.saturating_mul(HOUR),
    }
}

#[test]
fn what_is_left_on_the_disk_is_the_map_that_never_saw_it() {
    let spec = example::spec("home");
    let all = disk_without(&spec, &nothing());
    for selection in [
        select(None, Some(1), 0..i64::MAX),
        select(Some(&[1]), None, 30..75),
        select(Some(&[0, 2]), Some(0), 100..120),
        select(None, None, 8 * 24 + 13..9 * 24),
    ] {
        let disk = all.kill();
        let store = started(&disk, &Arc::default()).expect("starts");
        let erased = store.erase_part(MAP, &selection, false).expect("erases");
        assert!(erased.observations > 0 && erased.states > 0);
        let never = disk_without(&spec, &selection);
        let never = started(&never, &Arc::default()).expect("starts");
        let (left, never) = (comparable(content(&store, &spec)), comparable(content(&never, &spec)));
        assert_eq!(left.history, never.history, "{selection:?}");
        assert_eq!(left.snapshot, never.snapshot, "{selection:?}");
        assert_eq!(left.events, never.events, "{selection:?}");
        let again = store.erase_part(MAP, &selection, false);
        assert!(matches!(again, Err(EraseError::NotErasable(NotErasable::Nothing))));
        assert!(content(&store, &spec).events.len() == 2, "the map opens again");
    }
}

#[test]
fn an_erasure_of_a_part_that_is_cut_off_at_any_call_is_repeated_or_complete() {
    let spec = example::spec("home");
    let selection = select(None, Some(1), 0..i64::MAX);
    let (disk, erased) = (disk_without(&spec, &nothing()), disk_without(&spec, &nothing()));
    let before = content(&started(&disk.kill(), &Arc::default()).expect("starts"), &spec);
    let store = started(&erased, &Arc::default()).expect("starts");
    store.erase_part(MAP, &selection, true).expect("erases");
    let after = content(&store, &spec);
    assert_eq!(after.snapshot.producers[1].key.label(), "withdrawn 1:");
    with_faults(&spec, &disk, (&before, &after), &|store| store.erase_part(MAP, &selection, true).map(drop));
}

#[test]
fn a_forgotten_sequence_leaves_its_key_free_and_its_states() {
    let spec = example::spec("home");
    let disk = disk_without(&spec, &nothing());
    let store = started(&disk, &Arc::default()).expect("starts");
    let erase = |producer| store.erase_part(MAP, &select(None, Some(producer), 0..i64::MAX), true).expect("erases");
    assert!(erase(1).observations > 0);
    assert!(erase(0).observations > 0);
    // The order erases nothing more, and another key is free.
    assert_eq!(erase(0), Erased::default());
    let now = content(&store, &spec);
    let labels: Vec<&str> = now.snapshot.producers.iter().map(|mark| mark.key.label()).collect();
    assert_eq!(labels, ["withdrawn 1: withdrawn 1:", "withdrawn 1:"]);
    assert_eq!(now.snapshot.states.len(), STATES as usize);
    assert!(now.snapshot.states.iter().all(|state| state.observations == 0 && state.persistence.last().is_none()));
    assert!(now.history.iter().all(|(_, samples)| samples.is_empty()));
}

#[test]
fn without_its_history_a_state_is_not_changed() {
    let spec = MapSpec { retention: Retention::Duration(48 * HOUR), ..example::spec("home") };
    let disk = disk_without(&spec, &nothing());
    let before = content(&started(&disk.kill(), &Arc::default()).expect("starts"), &spec);
    let store = started(&disk, &Arc::default()).expect("starts");
    let refused = store.erase_part(MAP, &select(None, Some(1), 0..i64::MAX), false);
    assert!(matches!(&refused, Err(EraseError::NotErasable(NotErasable::HistoryIncomplete { .. }))), "{refused:?}");
    assert!(content(&store, &spec) == before);
    assert!(disk.list(Path::new("/data/maps/00000001")).expect("listed").iter().all(|name| name != "ERASE"));
}
