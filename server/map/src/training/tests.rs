//! Tests which models are trained again, on which data, and the outcome where they cannot be trained.

use std::{
    collections::BTreeMap,
    sync::{Mutex, atomic::AtomicU64},
};

use tidemap_model::{
    EnabledModels, Periodicities,
    catalogue::TRAINED_AT_NIGHT,
    models::{Calibrated, CalibratedOptions},
};

use super::*;
use crate::name::MapName;

const DAY: i64 = 86_400 * 1_000_000_000;
const HOUR: i64 = DAY / 24;

/// Readings of earlier updates, and a record of the requests.
#[derive(Debug, Default)]
struct Kept {
    readings: BTreeMap<StateId, Vec<Sample>>,
    requested: Mutex<Vec<Vec<ReadingsRequest>>>,
    damaged: Option<StateId>,
    is_short: bool,
}

impl StateReadings for Kept {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        self.requested.lock().expect("sound").push(wanted.to_vec());
        if let Some(damaged) = wanted.iter().find(|wanted| Some(wanted.state) == self.damaged) {
            return Err(format!("the file of {:?} is damaged", damaged.state));
        }
        let samples_for = |wanted: &ReadingsRequest| {
            let all = self.readings.get(&wanted.state).into_iter().flatten();
            all.filter(|sample| sample.utc_nanos >= wanted.from_nanos).copied().collect()
        };
        Ok(wanted.iter().skip(usize::from(self.is_short)).map(samples_for).collect())
    }
}

fn spec(retention: Retention) -> MapSpec {
    MapSpec {
        periodicities: Periodicities::harmonics(DAY, 4).expect("valid"),
        retention,
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

/// Samples every hour of some days; the state is open by day, each state an hour later than the state before.
fn samples(state: u32, days: std::ops::Range<i64>) -> Vec<Sample> {
    let sample = |hour: i64| {
        let open = (8..17).contains(&((hour - i64::from(state)).rem_euclid(24))) && hour % 7 != 3;
        Sample { utc_nanos: hour * HOUR, offset_secs: 0, value: f64::from(u8::from(open)) }
    };
    (days.start * 24..days.end * 24).map(sample).collect()
}

/// States that were updated up to a day, with the data of the last update and of the earlier updates.
struct World {
    spec: MapSpec,
    models: Vec<Arc<StateModel>>,
    own: Vec<(StateId, Vec<Sample>)>,
    kept: Kept,
}

impl World {
    fn new(spec: MapSpec, states: u32, days: i64) -> World {
        let mut world = World { spec, models: Vec::new(), own: Vec::new(), kept: Kept::default() };
        for state in 0..states {
            let mut model = StateModel::new(&world.spec.periodicities);
            model.update(&world.spec.periodicities, world.spec.update_rules(), samples(state, 0..days));
            world.models.push(Arc::new(model));
            world.own.push((StateId(state), samples(state, days - 1..days)));
            world.kept.readings.insert(StateId(state), samples(state, 0..days - 1));
        }
        world
    }

    /// Makes the model as if it had been trained on a day.
    fn trained_on(&mut self, state: usize, day: i32) {
        let model = Calibrated::train(Readings::new(&samples(9, 0..2)), CalibratedOptions::default()).expect("trained");
        self.models[state] = Arc::new(StateModel::clone(&self.models[state]).with_trained(model, LocalDay(day)));
    }

    fn train_due(&mut self, limits: Limits) -> TrainingOutcome {
        let newest = self.own.iter().flat_map(|(_, own)| own).map(|sample| sample.utc_nanos).max().expect("some");
        for (_, own) in &mut self.own {
            own.sort_by_key(|sample| sample.utc_nanos);
        }
        let of_state = self.models.iter_mut().zip(&self.own);
        let mut pupils: Vec<Pupil<'_>> =
            of_state.map(|(model, (id, own))| Pupil { id: *id, own: Taught::samples(own), model }).collect();
        train_within(limits, &self.spec, newest, &mut pupils, (&self.kept, &AtomicU64::new(0)))
    }

    fn trained_of(&self, state: usize) -> Option<(&Calibrated, i32)> {
        let (model, day) = self.models[state].alternatives()?.trained(ModelKind::Calibrated)?;
        let TrainedModel::Calibrated(model) = model else { panic!("another model") };
        Some((model, day.0))
    }

    /// The states requested, by batch.
    fn requested(&self) -> Vec<Vec<u32>> {
        let requested = self.kept.requested.lock().expect("sound");
        requested.iter().map(|batch| batch.iter().map(|wanted| wanted.state.0).collect()).collect()
    }
}

fn trained(samples: &[Sample]) -> Calibrated {
    Calibrated::train(Readings::new(samples), CalibratedOptions::default()).expect("trained")
}

#[test]
fn a_model_is_trained_on_the_last_weeks_and_to_what_the_update_had() {
    let mut world = World::new(spec(Retention::Forever), 2, 100);
    assert_eq!(world.train_due(LIMITS), TrainingOutcome { trained: 2, ..TrainingOutcome::default() });
    for state in 0..2 {
        let newest = 100 * DAY - HOUR;
        let mut expected = samples(state, 0..100);
        expected.retain(|sample| sample.utc_nanos >= newest - 84 * DAY);
        assert_eq!(world.trained_of(state as usize), Some((&trained(&expected), 99)));
    }
    assert_eq!(world.requested(), [[0, 1]]);
    // Nothing is due any more.
    assert_eq!(world.train_due(LIMITS), TrainingOutcome::default());
    assert_eq!(world.requested().len(), 1);
}

#[test]
fn late_readings_and_a_half_life_count() {
    let mut world = World::new(spec(Retention::Forever), 1, 20);
    world.spec.half_life_nanos = Some(3 * DAY);
    // This update also had an early day, which history lacks.
    let readings = world.kept.readings.get_mut(&StateId(0)).expect("known");
    readings.retain(|sample| sample.utc_nanos / DAY != 4);
    world.own[0].1.extend(samples(0, 4..5));
    assert_eq!(world.train_due(LIMITS).trained, 1);
    let all = samples(0, 0..20);
    let readings = Readings { half_life_secs: Some(3.0 * 86_400.0), ..Readings::new(&all) };
    let expected = Calibrated::train(readings, CalibratedOptions::default()).expect("trained");
    assert_ne!(expected, trained(&all));
    assert_eq!(world.trained_of(0), Some((&expected, 19)));
}

#[test]
fn readings_that_cannot_be_had_cost_the_models_of_their_batch_alone() {
    let mut world = World::new(spec(Retention::Forever), 5, 20);
    world.trained_on(2, 3);
    let before = world.models.clone();
    world.kept.damaged = Some(StateId(2));
    // The readings of two states fit at once.
    let outcome = world.train_due(Limits { readings: 2 * 20 * 24 + 5, ..LIMITS });
    assert_eq!(world.requested(), [vec![0, 1], vec![2, 3], vec![4]]);
    assert_eq!((outcome.trained, outcome.waiting, outcome.failed), (3, 0, 2));
    assert!(outcome.failure.expect("a reason").contains("StateId(2) is damaged"));
    for state in [2, 3] {
        assert_eq!(world.models[state], before[state]);
        assert!(world.models[state].is_training_due(ModelKind::Calibrated));
    }
    assert_eq!(world.trained_of(4).map(|(_, day)| day), Some(19));
    // The next update trains the states whose history is repaired.
    world.kept.damaged = None;
    assert_eq!(world.train_due(LIMITS), TrainingOutcome { trained: 2, ..TrainingOutcome::default() });
}

#[test]
fn a_source_that_leaves_a_state_out_is_not_believed() {
    let mut world = World::new(spec(Retention::Forever), 2, 20);
    world.kept.is_short = true;
    let outcome = world.train_due(LIMITS);
    assert_eq!((outcome.trained, outcome.failed), (0, 2));
    assert!(outcome.failure.is_some() && world.trained_of(1).is_none());
}

#[test]
fn those_that_have_waited_longest_go_first() {
    let mut world = World::new(spec(Retention::Forever), 6, 40);
    for (state, day) in [(0, 30), (1, 20), (2, 39), (3, 25)] {
        world.trained_on(state, day);
    }
    let days =
        |world: &World| (0..6).map(|state| world.trained_of(state).map(|(_, day)| day)).collect::<Vec<Option<i32>>>();
    // The models that were never trained go first, then the one trained longest ago; the one just trained is not due.
    let limits = Limits { models: |_| 3, ..LIMITS };
    assert_eq!(world.train_due(limits), TrainingOutcome { trained: 3, waiting: 2, ..TrainingOutcome::default() });
    assert_eq!(days(&world), [Some(30), Some(39), Some(39), Some(25), Some(39), Some(39)]);
    assert_eq!(world.train_due(limits), TrainingOutcome { trained: 2, ..TrainingOutcome::default() });
    assert_eq!(days(&world), [Some(39); 6]);
}

#[test]
fn nothing_is_trained_that_is_not_kept() {
    let mut world = World::new(spec(Retention::None), 2, 20);
    assert_eq!(world.train_due(LIMITS), TrainingOutcome::default());
    assert!(world.requested().is_empty() && world.trained_of(0).is_none());
    // The map does not request history that its retention has dropped; it trains a model on the rest anyway.
    let mut world = World::new(spec(Retention::Duration(5 * DAY)), 1, 20);
    assert_eq!(world.train_due(LIMITS).trained, 1);
    let newest = 20 * DAY - HOUR;
    let requested = world.kept.requested.lock().expect("sound").clone();
    assert_eq!(requested, [[ReadingsRequest { state: StateId(0), from_nanos: newest - 5 * DAY }]]);
    assert_eq!(world.trained_of(0).map(|(model, _)| model.observations()), Some(5 * 24 + 1));
}

#[test]
fn a_state_that_was_read_too_often_is_trained_on_fewer_days() {
    let mut world = World::new(spec(Retention::Forever), 2, 30);
    assert_eq!(world.train_due(Limits { readings: 240, ..LIMITS }).trained, 2);
    assert_eq!(world.requested(), [[0], [1]], "one at a time");
    for state in 0..2 {
        let observations = world.trained_of(state).expect("trained").0.observations();
        assert!((200..=281).contains(&observations), "{observations}");
    }
}

#[test]
fn each_kind_has_a_bound_of_its_own_and_what_is_not_enabled_is_not_trained() {
    let mut world = World::new(MapSpec { models: EnabledModels::ALL, ..spec(Retention::Forever) }, 3, 20);
    let limits = Limits { models: |kind| if kind == ModelKind::Calibrated { 9 } else { 1 }, ..LIMITS };
    assert_eq!(
        world.train_due(limits),
        TrainingOutcome { trained: 3 + 3, waiting: 3 * 2, ..TrainingOutcome::default() }
    );
    assert_eq!(world.train_due(limits), TrainingOutcome { trained: 3, waiting: 3, ..TrainingOutcome::default() });
    assert_eq!(world.train_due(limits), TrainingOutcome { trained: 3, ..TrainingOutcome::default() });
    assert_eq!(world.train_due(limits), TrainingOutcome::default());
    // The readings of a state are requested once, whatever is trained on them.
    assert_eq!(world.requested(), [vec![0, 1, 2], vec![1], vec![2]]);
    for (number, model) in world.models.iter().enumerate() {
        for kind in TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(StateKind::Probability)) {
            let (found, day) = model.alternatives().expect("learned").trained(kind).expect("trained");
            assert_eq!((found.kind_at_night(), day), (Some(kind), LocalDay(19)));
            let all = samples(number as u32, 0..20);
            let expected =
                kind.train(Readings::new(&all), StateKind::Probability, &world.spec.periodicities).expect("trained");
            assert_eq!(found, &expected);
        }
    }

    let mut world = World::new(MapSpec { models: EnabledModels::SPECTRAL, ..spec(Retention::Forever) }, 2, 20);
    assert_eq!((world.train_due(LIMITS), world.requested().len()), (TrainingOutcome::default(), 0));
}

#[test]
fn a_new_routine_is_trained_without_the_old_one() {
    let mut world = World::new(spec(Retention::Forever), 1, 60);
    let mut later = samples(0, 60..80);
    later.iter_mut().for_each(|sample| sample.value = 1.0 - sample.value);
    let mut model = StateModel::clone(&world.models[0]);
    model.update(&world.spec.periodicities, world.spec.update_rules(), later.clone());
    let since = model.alternatives().expect("learned").training_since().expect("it rang").0;
    assert!((58..66).contains(&since), "{since}");
    world.models[0] = Arc::new(model);
    world.own[0].1 = later.split_off(19 * 24);
    let kept = world.kept.readings.get_mut(&StateId(0)).expect("known");
    kept.extend(samples(0, 59..60).into_iter().chain(later));
    assert_eq!(world.train_due(LIMITS).trained, 1);
    assert_eq!(world.trained_of(0).map(|(model, _)| model.observations()), Some((80 - since as u64) * 24));
}
