//! Tests that updates train models, and that updates that are run again from the log train equal models.

use tidemap_model::{
    EnabledModels, Sample, StateKind,
    catalogue::{ModelKind, TRAINED_AT_NIGHT},
    selector::{Blend, ModelSelector},
};

use super::*;
use crate::{
    history::HistoryPiece,
    training::{ReadingsRequest, StateReadings, TrainingOutcome},
};

const DAYS: i64 = 40;

/// The history of the updates so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Pieces(pub(super) Vec<Arc<HistoryPiece>>);

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

/// A number in [0, 1) that seems random.
fn noise(seed: i64) -> f64 {
    let mixed = seed.unsigned_abs().wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

/// Two states read every hour of a day: one is open by day, the other at random.
fn day(day: i64) -> Vec<(u32, i64, f64)> {
    let rows = (0..24).flat_map(|hour| {
        let open = (8..17).contains(&hour) && (day + 3) % 7 < 5;
        let time = (day * 24 + hour) * HOUR;
        [(0, time, f64::from(u8::from(open))), (1, time, f64::from(u8::from(noise(day * 24 + hour) < 0.3)))]
    });
    rows.collect()
}

/// A door read every ten minutes of a day, opened and closed a little earlier or later each day.
fn office(day: i64) -> Vec<(u32, i64, f64)> {
    let (opened, closed) = (48 + (12.0 * noise(day)) as i64, 102 + (12.0 * noise(day + 1_000)) as i64);
    let value = |slot: i64| f64::from(u8::from((day + 3) % 7 < 5 && (opened..closed).contains(&slot)));
    (0..144).map(|slot| (0, (day * 144 + slot) * HOUR / 6, value(slot))).collect()
}

/// The map with every model enabled.
fn of_all() -> Arc<MapSpec> {
    Arc::new(MapSpec { models: EnabledModels::ALL, ..MapSpec::clone(&spec()) })
}

fn run(map: &mut LiveMap, work: UpdateWork, known: &mut Pieces) -> (MapSnapshot, TrainingOutcome) {
    let result = work.with_readings(Arc::new(known.clone())).run(&AtomicU64::new(0)).expect("in memory");
    let outcome = result.training_outcome().clone();
    let snapshot = map.finish_update(result);
    known.0.extend(snapshot.history.iter().cloned());
    (snapshot, outcome)
}

#[test]
fn updates_that_are_run_again_train_the_same_models() {
    let mut map = LiveMap::new(of_all());
    let (mut log, mut snapshots, mut known, mut trained) = (Vec::new(), Vec::new(), Pieces::default(), Vec::new());
    for number in 0..DAYS {
        let observed = event(&map, &day(number));
        assert!(apply(&mut map, &observed).is_none());
        let start = Event::UpdateStart(map.plan_update(Some((number + 1) * 24 * HOUR), NOW, UpdateCause::Midnight));
        let work = apply(&mut map, &start).expect("an update");
        let pieces_before = known.0.len();
        let (snapshot, outcome) = run(&mut map, work, &mut known);
        if outcome != TrainingOutcome::default() {
            // In the first week the cheap model alone is trained, for both states.
            let of_day = if number < 6 { 2 } else { 8 };
            assert_eq!(outcome, TrainingOutcome { trained: of_day, ..TrainingOutcome::default() });
            trained.push(number);
        }
        log.extend([observed, start]);
        snapshots.push((snapshot, pieces_before));
    }
    assert_eq!(trained, [2, 3, 4, 5, 6, 13, 20, 27, 34]);
    let expected = map.publish();
    for kind in TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(StateKind::Probability)) {
        assert!(
            expected.model(StateId(0)).alternatives().is_some_and(|known| known.trained(kind).is_some()),
            "{kind:?}"
        );
    }
    for (snapshot, pieces_before) in snapshots.into_iter().step_by(13) {
        let (position, from) = (snapshot.position, snapshot.replay_from);
        let mut restored = LiveMap::restore(of_all(), snapshot);
        // History reaches as far as the snapshot; later history comes from the updates that are run again.
        let mut again = Pieces(known.0[..=pieces_before].to_vec());
        for (at, event) in (1..).zip(&log).filter(|(at, _)| *at >= from) {
            if at <= position {
                restored.recover_pending(at, event).expect("consistent");
            } else if let Some(work) = restored.apply(at, event).expect("consistent") {
                run(&mut restored, work, &mut again);
            }
        }
        let view = restored.publish();
        for state in [0, 1].map(StateId) {
            assert_eq!(view.model(state), expected.model(state), "from position {position}");
        }
    }
}

#[test]
fn without_an_ensemble_auto_answers_by_the_models_that_predict_best_together() {
    let models = EnabledModels::default().without_ensemble();
    let mut map = LiveMap::new(Arc::new(MapSpec { models, ..MapSpec::clone(&spec()) }));
    let mut known = Pieces::default();
    for number in 0..DAYS {
        let observed = event(&map, &office(number));
        apply(&mut map, &observed);
        let start = Event::UpdateStart(map.plan_update(Some((number + 1) * 24 * HOUR), NOW, UpdateCause::Midnight));
        let work = apply(&mut map, &start).expect("an update");
        run(&mut map, work, &mut known);
    }
    let view = map.publish();
    let model = view.model(StateId(0));
    let errors: Vec<_> = model.alternatives().expect("learned").error_sums().collect();
    assert_eq!(model.choice(), ModelKind::Calibrated, "{errors:?}");
    let times: Vec<i64> = (0..7 * 24).map(|hour| (DAYS * 24 + hour) * HOUR + HOUR / 3).collect();
    let prepared = view.prepare(&times);
    let predicted = |selector: ModelSelector| {
        let mut out = vec![0.0; times.len()];
        view.predict_into(StateId(0), &prepared, selector, &mut out);
        out
    };
    let (calibrated, _) = model.alternatives().and_then(|known| known.trained(ModelKind::Calibrated)).expect("trained");
    let auto = ModelSelector::default();
    let mut expected = vec![0.0; times.len()];
    view.predict_trained_into(StateId(0), &view.moments(&times), calibrated, auto, &mut expected);
    let periodicities = &view.spec().periodicities;
    let mut together = vec![0.0; times.len()];
    let chosen = model.chosen(periodicities).expect("not the spectral model alone");
    view.predict_trained_into(StateId(0), &view.moments(&times), &chosen, auto, &mut together);
    for ((auto, together), calibrated) in predicted(auto.long_term()).iter().zip(&together).zip(&expected) {
        assert!((auto - together).abs() <= 1e-12, "{auto}, {together}");
        // The errors of the calibrated model are by far the lowest.
        assert!((auto - calibrated).abs() <= 0.02, "{auto}, {calibrated}");
    }
    assert_eq!(auto.order_for(model), 0);
    // A request for an order is a request for the spectral model.
    assert_ne!(predicted(ModelSelector { order: Some(2), ..auto }), expected);
    assert_ne!(predicted(ModelSelector { kind: ModelKind::Spectral, ..auto }), expected);
    assert_ne!(predicted(ModelSelector { blend: Blend::Persistence, ..auto }), expected);
}

#[test]
fn a_record_is_learned_alike_in_one_update_and_night_by_night() {
    let learned = |nights: &dyn Fn(i64) -> bool| {
        let (mut map, mut known) = (LiveMap::new(of_all()), Pieces::default());
        for number in 0..DAYS {
            let observed = event(&map, &day(number));
            apply(&mut map, &observed);
            if nights(number) || number + 1 == DAYS {
                let until = Some((number + 1) * 24 * HOUR);
                let start = Event::UpdateStart(map.plan_update(until, NOW, UpdateCause::Request));
                let work = apply(&mut map, &start).expect("an update");
                run(&mut map, work, &mut known);
            }
        }
        map.publish()
    };
    let nightly = learned(&|_| true);
    let others = [learned(&|_| false), learned(&|number| number < 3 || number == 20)];
    for other in others {
        for state in [0, 1].map(StateId) {
            assert_eq!(other.model(state), nightly.model(state));
        }
    }
}
