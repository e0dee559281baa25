//! A map after an erasure of observations equals a map that never had them, with updates at the same cuts.

use proptest::prelude::*;
use tidemap_model::{EnabledModels, Sample};

use super::*;
use crate::training::{ReadingsRequest, StateReadings};

const DAY: i64 = 24 * HOUR;
const STATES: u32 = 4;
const PRODUCERS: u32 = 3;

#[derive(Clone, Debug, Default)]
struct Pieces(Vec<Arc<HistoryPiece>>);

impl StateReadings for Pieces {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        let samples_for = |wanted: &ReadingsRequest| {
            let all = self.0.iter().flat_map(|piece| &piece.states).filter(|(state, _)| *state == wanted.state);
            let mut found: Vec<Sample> =
                all.flat_map(|(_, samples)| samples).filter(|s| s.utc_nanos >= wanted.from_nanos).copied().collect();
            found.sort_by_key(|sample| sample.utc_nanos);
            found
        };
        Ok(wanted.iter().map(samples_for).collect())
    }
}

fn spec(models: EnabledModels) -> Arc<MapSpec> {
    Arc::new(MapSpec { models, ..MapSpec::clone(&super::spec()) })
}

/// A batch of observations, then perhaps an update.
#[derive(Clone, Debug)]
struct Step {
    producer: u32,
    /// State, time in minutes since the beginning of the day, value in quarters.
    rows: Vec<(u32, i64, u8)>,
    /// The time by which the update's cut is before the end of the day, in minutes, and the update's cause.
    update: Option<(i64, bool)>,
}

fn step() -> impl Strategy<Value = Step> {
    let row = (0..STATES, prop_oneof![8 => 0..1440_i64, 1 => 1440..1500_i64, 1 => 2900..3000_i64], 0..=4_u8);
    let update =
        prop::option::weighted(0.9, (prop_oneof![3 => Just(0_i64), 1 => 0..600_i64], prop::bool::weighted(0.9)));
    (0..PRODUCERS, prop::collection::vec(row, 1..30), update).prop_map(|(producer, rows, update)| Step {
        producer,
        rows,
        update,
    })
}

/// The events of a story; each step is on a different day.
fn story(steps: &[Step]) -> Vec<Event> {
    let (mut events, mut sequences, mut known) = (Vec::new(), [0_u64; PRODUCERS as usize], 0);
    let (mut generation, mut cut_nanos) = (0, 0);
    for (day, step) in (0..).zip(steps) {
        let from = day * DAY;
        let producer = step.producer as usize;
        let state_count = step.rows.iter().map(|(state, ..)| state + 1).max().unwrap_or(0).max(known);
        let count = u32::try_from(step.rows.len()).expect("few");
        let new = |id: u32| {
            let shape = StateShape::Scalar(StateKind::Probability);
            NewState::sampled(StateId(id), named(&format!("s{id}")), shape)
        };
        let key = ProducerKey::new(&format!("robot-{producer}"), "").expect("valid");
        events.push(Event::Observations(
            Envelope {
                producer: ProducerId(step.producer),
                new_producer: (sequences[producer] == 0).then(|| key.into()),
                incarnation: 1,
                span: SequenceSpan {
                    first: sequences[producer] + 1,
                    last: sequences[producer] + u64::from(count),
                    content_crc: 7,
                },
                // An observation of the day after tomorrow waits.
                received_nanos: from + DAY,
                refused: Vec::new(),
            },
            Observations {
                new_states: (known..state_count).map(new).collect(),
                states: step.rows.iter().map(|(state, ..)| StateId(*state)).collect(),
                times_nanos: step.rows.iter().map(|(_, minute, _)| from + minute * HOUR / 60).collect(),
                values: step.rows.iter().map(|(.., quarters)| f64::from(*quarters) / 4.0).collect(),
                offsets: vec![OffsetRun { count, offset_secs: 3600 }],
                failures: Vec::new(),
                runs: Vec::new(),
            },
        ));
        (sequences[producer], known) = (sequences[producer] + u64::from(count), state_count);
        if let Some((minutes, is_nightly)) = step.update {
            generation += 1;
            cut_nanos = (from + DAY - minutes * HOUR / 60).max(cut_nanos);
            let cause = if is_nightly { UpdateCause::Midnight } else { UpdateCause::PendingLimit };
            events.push(Event::UpdateStart(crate::event::UpdateStart { generation, cut_nanos, cause }));
        }
    }
    number_producers(&mut events);
    events
}

/// Producers get their numbers in the order in which they appear.
fn number_producers(events: &mut [Event]) {
    let mut order = Vec::new();
    for event in events {
        if let Event::Observations(event, _) = event {
            if !order.contains(&event.producer) {
                order.push(event.producer);
            }
            let at = order.iter().position(|known| *known == event.producer).expect("known");
            event.producer = ProducerId(u32::try_from(at).expect("few"));
        }
    }
}

/// A map after it has applied the events, from a snapshot with its history or from nothing; also returns all snapshots
/// that its updates published.
fn applied(
    spec: &Arc<MapSpec>,
    events: &[Event],
    from: Option<&MapSnapshot>,
    pieces: Vec<Arc<HistoryPiece>>,
) -> (LiveMap, Vec<MapSnapshot>, Vec<Arc<HistoryPiece>>) {
    let mut map =
        from.map_or_else(|| LiveMap::new(Arc::clone(spec)), |from| LiveMap::restore(Arc::clone(spec), from.clone()));
    let (mut known, mut published) = (Pieces(pieces), Vec::new());
    let (position, replay_from) = from.map_or((0, 1), |from| (from.position, from.replay_from));
    for (at, event) in (1..).zip(events).filter(|(at, _)| *at >= replay_from) {
        if at <= position {
            map.recover_pending(at, event).expect("consistent");
        } else if let Some(work) = map.apply(at, event).expect("consistent") {
            let readings = Arc::new(known.clone());
            let result = work.with_readings(readings).run(&AtomicU64::new(0)).expect("in memory");
            let mut snapshot = map.finish_update(result);
            known.0.append(&mut snapshot.history);
            published.push(snapshot);
        }
    }
    (map, published, known.0)
}

/// The events without the selected observations.
fn naive(events: &[Event], selection: &Selection) -> Vec<Event> {
    let without = |event: &Event| match event {
        Event::Observations(envelope, event) => {
            let mut left = event.clone();
            let is_left = |state: StateId, nanos: i64| {
                let of_state = selection.states.as_ref().is_none_or(|states| states.contains(&state));
                let by = selection.producers.as_ref().is_none_or(|producers| producers.contains(&envelope.producer));
                !(of_state && by && selection.from_nanos <= nanos && nanos < selection.to_nanos)
            };
            let kept: Vec<_> = event.samples().filter(|(state, sample)| is_left(*state, sample.utc_nanos)).collect();
            left.states = kept.iter().map(|(state, _)| *state).collect();
            left.times_nanos = kept.iter().map(|(_, sample)| sample.utc_nanos).collect();
            left.values = kept.iter().map(|(_, sample)| sample.value).collect();
            let count = u32::try_from(kept.len()).expect("few");
            left.offsets = if count > 0 { vec![OffsetRun { count, offset_secs: 3600 }] } else { Vec::new() };
            Event::Observations(envelope.clone(), left)
        }
        event => event.clone(),
    };
    events.iter().map(without).collect()
}

fn decided(
    selection: &Selection,
    snapshot: Option<&MapSnapshot>,
    pieces: &[Arc<HistoryPiece>],
    events: &[Event],
) -> Result<Decision, NotErasable> {
    let mut survey = Survey::new(selection.clone(), snapshot);
    pieces.iter().for_each(|piece| survey.history(piece));
    let from = snapshot.map_or(1, |snapshot| snapshot.replay_from);
    (1..).zip(events).filter(|(at, _)| *at >= from).for_each(|(at, event)| survey.event(at, event));
    survey.decide()
}

fn erasure(
    spec: &MapSpec,
    selection: &Selection,
    decision: &Decision,
    snapshot: Option<&MapSnapshot>,
    pieces: &[Arc<HistoryPiece>],
    erased: Vec<StateId>,
) -> StateErasure {
    let states = decision.relearned.iter().filter_map(|id| Some((*id, snapshot?.states.get(id.0 as usize)?.clone())));
    let mut relearning = Relearning::new(spec, selection, decision, states.collect());
    let generation = snapshot.map_or(0, |snapshot| snapshot.generation);
    let before = pieces.iter().filter(|piece| piece.generation <= generation);
    before.for_each(|piece| relearning.history(piece, piece.to_nanos));
    let relearned = relearning.learn().expect("in memory").into_iter().collect();
    StateErasure::of_part(erased, selection.clone(), decision.clone(), relearned)
}

fn comparable(snapshot: &MapSnapshot) -> MapSnapshot {
    MapSnapshot { history: Vec::new(), replay_from: 0, ..snapshot.clone() }
}

fn selection() -> impl Strategy<Value = Selection> {
    let some = |count: u32| prop::option::of(prop::collection::btree_set(0..count, 1..3));
    (some(STATES), some(PRODUCERS), 0..14_i64 * 24, 1..200_i64).prop_map(|(states, producers, from, hours)| Selection {
        states: states.map(|ids| ids.into_iter().map(StateId).collect()),
        producers: producers.map(|ids| ids.into_iter().map(ProducerId).collect()),
        from_nanos: from * HOUR,
        to_nanos: (from + hours) * HOUR,
    })
}

fn compare(models: EnabledModels, steps: &[Step], selection: &Selection, saved: usize) -> Result<(), TestCaseError> {
    let spec = &spec(models);
    let events = story(steps);
    let (_, published, pieces) = applied(spec, &events, None, Vec::new());
    let naive = naive(&events, selection);
    let (mut never, of_never, never_pieces) = applied(spec, &naive, None, Vec::new());
    let never_observed = never.publish().observations();
    // The newest checkpoint may be older than the end of the log, and the history may be newer than the checkpoint.
    let at = saved % (published.len() + 1);
    let snapshot = at.checked_sub(1).and_then(|at| published.get(at));
    let decision = match decided(selection, snapshot, &pieces, &events) {
        Ok(decision) => decision,
        Err(NotErasable::Nothing) => {
            prop_assert_eq!(naive, events);
            return Ok(());
        }
        Err(error) => panic!("{error:?}"),
    };
    for emptied in [Vec::new(), decision.emptied.clone()] {
        let mut rewrite = erasure(spec, selection, &decision, snapshot, &pieces, emptied.clone());
        let after = snapshot.map(|snapshot| rewrite.snapshot(snapshot.clone()));
        let left: Vec<Event> =
            (1..).zip(&events).map(|(position, event)| rewrite.event(position, event.clone())).collect();
        let kept: Vec<_> = pieces.iter().filter_map(|piece| rewrite.piece(piece)).map(Arc::new).collect();
        // The ids of the remaining states, in a map that never had the states without remaining observations.
        let mut without = StateErasure::new(emptied.clone());
        let mut expected = |snapshot: &MapSnapshot| comparable(&without.snapshot(snapshot.clone()));
        if let (Some(after), Some(at)) = (&after, at.checked_sub(1)) {
            prop_assert_eq!(comparable(after), expected(&of_never[at]));
            let generation = after.generation;
            let known = |pieces: &[Arc<HistoryPiece>]| -> Vec<Arc<HistoryPiece>> {
                pieces.iter().filter(|piece| piece.generation <= generation).cloned().collect()
            };
            let ids = StateErasure::new(emptied.clone());
            let of_never: Vec<_> =
                known(&never_pieces).iter().filter_map(|piece| ids.piece(piece)).map(Arc::new).collect();
            prop_assert_eq!(known(&kept), of_never);
        }
        let generation = after.as_ref().map_or(0, |after| after.generation);
        let before = kept.into_iter().filter(|piece| piece.generation <= generation).collect();
        let (mut restored, again, all) = applied(spec, &left, after.as_ref(), before);
        if let (Some(again), Some(never)) = (again.last(), of_never.last()) {
            prop_assert_eq!(comparable(again), expected(never));
        }
        if emptied.is_empty() {
            prop_assert_eq!(all, never_pieces.clone());
            prop_assert_eq!((restored.pending(), restored.future()), (never.pending(), never.future()));
            prop_assert_eq!(restored.publish().observations(), never_observed);
        }
    }
    let count: u64 = [&events, &naive]
        .map(|events| {
            events
                .iter()
                .map(|event| match event {
                    Event::Observations(_, event) => event.states.len() as u64,
                    _ => 0,
                })
                .sum::<u64>()
        })
        .into_iter()
        .reduce(|all, left| all - left)
        .unwrap_or(0);
    prop_assert_eq!(decision.observations, count);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn what_is_left_is_the_map_that_never_saw_it(
        steps in prop::collection::vec(step(), 2..16),
        selection in selection(),
        saved in 0..30_usize,
    ) {
        compare(EnabledModels::default(), &steps, &selection, saved)?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    #[ignore = "slow: every model is trained"]
    fn so_it_is_with_every_model(
        steps in prop::collection::vec(step(), 2..16),
        selection in selection(),
        saved in 0..30_usize,
    ) {
        compare(EnabledModels::ALL, &steps, &selection, saved)?;
    }
}

#[test]
fn what_the_history_does_not_contain_is_refused() {
    let step = |producer| Step {
        producer,
        rows: (0..20).map(|at| (at % 2, 60 * i64::from(at), 4)).collect(),
        update: Some((0, true)),
    };
    let events = story(&[step(0), step(1), step(0), Step { update: None, ..step(1) }]);
    let (_, published, pieces) = applied(&spec(EnabledModels::default()), &events, None, Vec::new());
    let snapshot = published.last();
    let selection = |producer: Option<u32>, from_nanos: i64| Selection {
        states: None,
        producers: producer.map(|producer| [ProducerId(producer)].into()),
        from_nanos,
        to_nanos: i64::MAX,
    };
    assert!(decided(&selection(Some(0), 0), snapshot, &pieces, &events).is_ok());
    // The file of the day was deleted.
    let pending_from_nanos = 3 * DAY;
    let refused = decided(&selection(None, DAY), snapshot, &pieces[1..], &events);
    let missing = NotErasable::HistoryIncomplete { state: named("s0"), kept_from_nanos: Some(DAY), pending_from_nanos };
    assert_eq!(refused, Err(missing));
    let later = decided(&selection(None, pending_from_nanos), snapshot, &pieces[1..], &events).expect("pending only");
    assert_eq!((later.observations, later.relearned), (20, Vec::new()));
    assert_eq!(decided(&selection(Some(2), 0), snapshot, &pieces, &events), Err(NotErasable::Nothing));
}

#[test]
fn what_waits_beside_what_had_waited_is_withdrawn() {
    let step = |rows: &[(u32, i64, u8)], update| Step { producer: 0, rows: rows.to_vec(), update };
    let steps = [step(&[(1, 1446, 0), (1, 2900, 0), (1, 0, 0)], None), step(&[(0, 0, 0)], Some((0, false)))];
    let (from_nanos, to_nanos) = (25 * HOUR, 49 * HOUR);
    let selection = Selection { states: None, producers: None, from_nanos, to_nanos };
    for (saved, models) in [(0, EnabledModels::default()), (1, EnabledModels::default()), (1, EnabledModels::ALL)] {
        compare(models, &steps, &selection, saved).expect("as if never observed");
    }
}
