//! Tests vectors: a state of continuous values for each axis, all of them or none.

use super::*;
use crate::event::{Dimensions, StateShape};

fn vector(id: u32, name: &str, dimensions: Dimensions) -> Event {
    let name = StateName::new(name).expect("valid");
    Event::AddState(NewState::sampled(StateId(id), name, StateShape::Vector(dimensions)))
}

fn scalar(id: u32, name: &str) -> Event {
    let name = StateName::new(name).expect("valid");
    Event::AddState(NewState::sampled(StateId(id), name, StateShape::default()))
}

#[test]
fn a_vector_is_there_with_all_its_axes() {
    let mut map = LiveMap::new(spec());
    apply(&mut map, &vector(0, "anna", Dimensions::Two));
    apply(&mut map, &vector(2, "drone", Dimensions::Three));
    apply(&mut map, &scalar(5, "door"));
    let view = map.publish();
    let names: Vec<&str> = view.infos().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["anna/x", "anna/y", "drone/x", "drone/y", "drone/z", "door"]);
    let shapes = ["anna", "drone", "door", "anna/y", "nobody"].map(|name| view.shape(name));
    assert_eq!(
        shapes,
        [
            Some((StateId(0), StateShape::Vector(Dimensions::Two))),
            Some((StateId(2), StateShape::Vector(Dimensions::Three))),
            Some((StateId(5), StateShape::default())),
            Some((StateId(1), StateShape::Scalar(StateKind::Continuous))),
            None,
        ]
    );
    // A name always has one shape, and state ids have no gaps.
    for wrong in [vector(6, "anna", Dimensions::Three), vector(6, "door", Dimensions::Two), scalar(6, "drone")] {
        let error = map.apply(map.position() + 1, &wrong).expect_err("not new");
        assert!(error.reason.contains("is not new"), "{error}");
    }
    assert!(map.apply(map.position() + 1, &vector(7, "new", Dimensions::Two)).is_err());
    assert_eq!(map.states(), 6);
}

#[test]
fn an_angle_is_there_with_its_cosine_and_its_sine() {
    let mut map = LiveMap::new(spec());
    let angle = |id: u32, name: &str| {
        let name = StateName::new(name).expect("valid");
        Event::AddState(NewState::sampled(StateId(id), name, StateShape::Angle))
    };
    apply(&mut map, &angle(0, "heading"));
    apply(&mut map, &vector(2, "anna", Dimensions::Two));
    let view = map.publish();
    let names: Vec<&str> = view.infos().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["heading/cos", "heading/sin", "anna/x", "anna/y"]);
    assert_eq!(view.shape("heading"), Some((StateId(0), StateShape::Angle)));
    for wrong in [angle(4, "anna"), angle(4, "heading"), scalar(4, "heading"), vector(4, "heading", Dimensions::Two)] {
        let error = map.apply(map.position() + 1, &wrong).expect_err("not new");
        assert!(error.reason.contains("is not new"), "{error}");
    }
    let snapshot = update(&mut map, None);
    let mut restored = LiveMap::restore(spec(), snapshot);
    assert_eq!(restored.publish().shape("heading"), Some((StateId(0), StateShape::Angle)));
}

#[test]
fn positions_are_learned_by_axis_and_restored() {
    let mut map = LiveMap::new(spec());
    apply(&mut map, &vector(0, "anna", Dimensions::Two));
    let rows: Vec<(u32, i64, f64)> = (0..240)
        .flat_map(|hour| {
            let is_late = f64::from(u8::from(hour % 24 >= 12));
            [(0, hour * HOUR, 8.0 * is_late - 4.0), (1, hour * HOUR, 100.0 - is_late)]
        })
        .collect();
    let observed = event(&map, &rows);
    apply(&mut map, &observed);
    let snapshot = update(&mut map, None);
    let predicted = |view: &MapView| [0, 1].map(|axis| predict(view, axis, (240 + 18) * HOUR));
    let [x, y] = predicted(&map.publish());
    assert!((x - 4.0).abs() < 1.5 && (y - 99.0).abs() < 0.3, "{x}, {y}");
    let mut restored = LiveMap::restore(spec(), snapshot);
    let view = restored.publish();
    assert_eq!(
        (view.shape("anna"), predicted(&view)),
        (Some((StateId(0), StateShape::Vector(Dimensions::Two))), [x, y])
    );
}
