//! Tests the names of landmarks' states.

use super::*;

fn name(text: &str) -> StateName {
    StateName::new(text).expect("a name")
}

#[test]
fn a_stored_name_identifies_place_and_landmark() {
    for (place, state) in [
        ("hall", "landmark/hall/17"),
        ("hall/lab", "landmark/hall/lab/17"),
        ("hall/lab/door", "landmark/hall/lab/door/17"),
    ] {
        let place = PlaceName::parse(place).expect("a place");
        assert_eq!(place.landmark(&name("17")).as_str(), state);
        assert_eq!(split(state), Some(Ok((place, name("17")))));
        assert_eq!(StateName::stored(state).expect("stored").as_str(), state);
        assert_eq!(StateName::chars_max(state), LANDMARK_STATE_CHARS_MAX);
    }
}

#[test]
fn producers_cannot_use_the_name_and_wrong_ones_are_refused() {
    assert!(StateName::observed("landmark/hall/17").is_err());
    for wrong in ["landmark//17", "landmark/hall/", "landmark/a/b/c/d/17", "landmark/hall/lab/ /\u{7}"] {
        assert!(StateName::stored(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn landmarks_go_with_a_renamed_node() {
    let renamed = |state: &str| {
        let stored = StateName::stored(state).expect("stored");
        stored.with_node_renamed("hall", &name("foyer")).map(|name| name.expect("valid").to_string())
    };
    assert_eq!(renamed("landmark/hall/hall").as_deref(), Some("landmark/foyer/hall"));
    assert_eq!(renamed("landmark/lab/hall/hall").as_deref(), Some("landmark/lab/foyer/hall"));
    assert_eq!(renamed("landmark/lab/hall"), None);
}
