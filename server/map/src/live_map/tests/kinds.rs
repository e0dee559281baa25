//! Tests states that are not probabilities: how they are created, which values they take and which values views show.

use tidemap_model::{
    models::Moment,
    selector::{Blend, ModelKind, ModelSelector},
};

use super::*;

fn new_state(id: u32, kind: StateKind) -> Event {
    let name = StateName::new(&format!("s{id}")).expect("valid");
    Event::AddState(NewState::sampled(StateId(id), name, kind))
}

/// A map with one state of each kind: probability, continuous, count.
fn mixed() -> LiveMap {
    let mut map = LiveMap::new(spec());
    for (id, kind) in (0..).zip(StateKind::ALL) {
        assert!(apply(&mut map, &new_state(id, kind)).is_none());
    }
    map
}

fn predict_by(view: &MapView, state: u32, selector: ModelSelector, time: i64) -> f64 {
    let mut out = [f64::NAN];
    view.predict_into(StateId(state), &view.prepare(&[time]), selector, &mut out);
    out[0]
}

#[test]
fn a_state_that_was_added_is_there_before_anything_is_observed_of_it() {
    let mut map = mixed();
    let view = map.publish();
    let kinds: Vec<StateKind> = view.infos().map(|info| info.kind).collect();
    assert_eq!(kinds, StateKind::ALL);
    assert_eq!((view.observations(), view.position()), (0, 3));
    for (id, expected) in [(0, 0.5), (1, 0.0), (2, 0.0)] {
        for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Latest, ModelKind::Spectral] {
            for blend in [Blend::None, Blend::Persistence, Blend::Memory] {
                let selector = ModelSelector { kind, order: None, blend };
                assert_eq!(predict_by(&view, id, selector, HOUR), expected, "state {id}, {selector:?}");
            }
        }
        let moments = [Moment { utc_nanos: HOUR, offset_secs: 0 }];
        let bands = view.intervals(StateId(id), (&moments, &[expected]), ModelSelector::default(), Some(0.9));
        assert_eq!(bands.len(), usize::from(id == 0), "of nothing there is no deviation");
    }
    let position = map.position() + 1;
    assert!(map.apply(position, &new_state(1, StateKind::Continuous)).is_err(), "it is not new");
    assert!(map.apply(position, &new_state(7, StateKind::Continuous)).is_err(), "a number is left out");
}

#[test]
fn a_state_keeps_its_sensor_and_believes_it_before_and_after_an_update() {
    let sensor = tidemap_model::StateSensor::new(0.9, 0.05).expect("a sensor");
    let mut map = LiveMap::new(spec());
    let name = StateName::new("s0").expect("valid");
    let new = NewState {
        id: StateId(0),
        name,
        shape: StateShape::default(),
        labels: Vec::new(),
        sensor: Some(sensor),
        reporting: Reporting::Samples,
    };
    apply(&mut map, &Event::AddState(new));
    let read = event(&map, &[(0, HOUR, 1.0)]);
    apply(&mut map, &read);
    // Before the reading, both values are equally likely.
    let expected = 0.05 + 0.85 * 0.9 / 0.95;
    let now = |map: &mut LiveMap| predict_by(&map.publish(), 0, ModelSelector::default(), HOUR);
    assert!((now(&mut map) - expected).abs() < 1e-12);
    let snapshot = update(&mut map, None);
    assert!((now(&mut map) - expected).abs() < 1e-12);
    let mut restored = LiveMap::restore(spec(), snapshot);
    assert_eq!(restored.sensor(StateId(0)), Some(sensor));
    assert!((now(&mut restored) - expected).abs() < 1e-12);
    assert_eq!(restored.publish().info(StateId(0)).and_then(|info| info.sensor), Some(sensor));
}

#[test]
fn a_log_with_values_beyond_the_bounds_of_a_state_is_refused() {
    for (state, value) in [(0, 1.5), (0, -0.5), (1, 1e13), (1, f64::NAN), (2, -1.0)] {
        let mut map = mixed();
        let wrong = event(&map, &[(state, HOUR, value)]);
        let error = map.apply(map.position() + 1, &wrong).expect_err("out of bounds");
        assert!(error.reason.contains(&value.to_string()), "{error}");
    }
    let mut map = mixed();
    let fine = event(&map, &[(0, HOUR, 1.0), (1, HOUR, -1e12), (2, HOUR, 1e12)]);
    assert!(apply(&mut map, &fine).is_none());
}

#[test]
fn values_are_learned_restored_and_predicted_in_their_unit() {
    let mut map = mixed();
    let rows: Vec<(u32, i64, f64)> = (0..240)
        .flat_map(|hour| {
            let swing = f64::from(u8::from(hour % 24 >= 12));
            [(0, hour * HOUR, swing), (1, hour * HOUR, 300.0 * swing - 400.0), (2, hour * HOUR, 7.0 * swing)]
        })
        .collect();
    let observed = event(&map, &rows);
    apply(&mut map, &observed);
    let snapshot = update(&mut map, None);
    let check = |view: &MapView| {
        let at = |state, hours: i64| predict_by(view, state, ModelSelector::default(), 240 * HOUR + hours * HOUR);
        assert!((at(1, 6) + 400.0).abs() < 40.0 && (at(1, 18) + 100.0).abs() < 40.0, "{} {}", at(1, 6), at(1, 18));
        assert!(at(2, 6) < 1.0 && at(2, 6) >= 0.0 && (at(2, 18) - 7.0).abs() < 1.0, "{} {}", at(2, 6), at(2, 18));
        let latest = ModelSelector { kind: ModelKind::Latest, ..ModelSelector::default() };
        assert_eq!(predict_by(view, 1, latest, 300 * HOUR), -100.0);
        // The last value fades within hours, because the state changes twice a day.
        let mean = ModelSelector { kind: ModelKind::Mean, blend: Blend::Persistence, ..ModelSelector::default() };
        let [soon, late] = [240, 400].map(|hour| predict_by(view, 1, mean, hour * HOUR));
        assert!((soon + 100.0).abs() < 30.0 && (late + 250.0).abs() < 5.0, "{soon} {late}");
        for (state, p) in [(1, at(1, 18)), (2, at(2, 6))] {
            let moment = Moment { utc_nanos: 258 * HOUR, offset_secs: 0 };
            let band =
                view.intervals(StateId(state), (&[moment], &[p]), ModelSelector::default(), Some(0.9))[0].interval;
            assert!(band.contains(p) && band.width() > 0.0 && band.width() < 800.0, "{band:?}");
            assert!(state != 2 || band.lower >= 0.0, "{band:?}");
        }
    };
    check(&map.publish());
    let mut restored = LiveMap::restore(spec(), snapshot);
    assert_eq!(restored.kind(StateId(2)), Some(StateKind::Count));
    check(&restored.publish());
}
