//! Names of edges and their states, there and back.

use proptest::prelude::*;

use super::*;

#[test]
fn the_states_of_an_edge_have_a_name_each() {
    let edge = EdgeName::new("Hall", "Büro 2", "").expect("valid");
    assert_eq!(edge.to_string(), "Hall/Büro 2");
    assert_eq!(StateName::edge(&edge).as_str(), "edge/Hall/Büro 2");
    let door = EdgeName::new("Hall", "x", "door").expect("valid");
    assert_eq!(StateName::speed(&door).as_str(), "speed/Hall/x/door");
    assert_eq!(StateName::pace(&door).as_str(), "pace/Hall/x/door");
    assert_eq!(StateName::pace(&door).as_edge(), Some((EdgeState::Pace, door.clone())));
    assert_eq!(EdgeName::parse("Hall/x/door"), Ok(door));
    let plain = StateName::new("edge").expect("valid");
    assert_eq!(plain.as_edge(), None);
    for bad in ["", "Hall", "Hall/", "Hall//", "/Hall", "Hall/x/", "Hall/x/door/", "Hall/x/a/b", "Hall/a\nb"] {
        assert!(EdgeName::parse(bad).is_err(), "{bad:?}");
    }
    assert!(EdgeName::new("a/b", "c", "").is_err());
    assert!(EdgeName::new("a", "b", "c/d").is_err());
}

#[test]
fn names_of_edges_are_stored_and_never_observed() {
    for good in ["edge/A/B", "speed/A/x", "pace/A/B/x", "speed/x/y"] {
        let name = StateName::stored(good).expect("stored");
        assert_eq!((name.as_str(), name.as_axis()), (good, None));
        assert_eq!(StateName::observed(good), Err(InvalidName::Slash(good.to_owned())));
        assert!(name.check_vector().is_err());
    }
    // A vector may have this name, and its axes are not states of edges.
    let axis = StateName::stored("speed/x").expect("an axis");
    assert_eq!((axis.as_axis(), axis.as_edge()), (Some(("speed", 0)), None));
    for bad in
        ["edge/A", "edge/x", "edge/A//c", "edge/A/B/", "edge/A/B/c/d", "Edge/A/B", "rate/A/B", "speed/A/u\u{308}"]
    {
        assert!(StateName::stored(bad).is_err(), "{bad}");
    }
}

#[test]
fn the_longest_names_are_bounded() {
    let longest = "ü".repeat(NAME_CHARS_MAX);
    let edge = EdgeName::new(&longest, &longest, &longest).expect("valid");
    let name = StateName::speed(&edge);
    assert_eq!(name.as_str().chars().count(), EDGE_STATE_CHARS_MAX);
    assert_eq!(StateName::stored(name.as_str()), Ok(name.clone()));
    assert_eq!(StateName::chars_max(name.as_str()), EDGE_STATE_CHARS_MAX);
    assert_eq!(StateName::chars_max("speed/x"), NAME_CHARS_MAX);
    assert!(matches!(StateName::stored(&format!("{name}ü")), Err(InvalidName::TooLong { .. })));
}

proptest! {
    #[test]
    fn a_state_name_contains_its_edge(from in "[^/\\p{C}]{1,9}", to in "[^/\\p{C}]{1,9}", action in "[^/\\p{C}]{0,9}") {
        let Ok(edge) = EdgeName::new(&from, &to, &action) else { return Ok(()) };
        for what in EdgeState::ALL {
            let name = edge.state(what);
            prop_assert_eq!(name.as_edge(), Some((what, edge.clone())));
            prop_assert_eq!(StateName::stored(name.as_str()), Ok(name));
        }
    }
}
