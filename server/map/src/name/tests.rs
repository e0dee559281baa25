//! Tests which names are accepted, and that each object has one name.

use super::*;

#[test]
fn map_names_follow_the_pattern() {
    for good in ["a", "0", "office-2", "a_b", &"m".repeat(63)] {
        assert!(MapName::new(good).is_ok(), "{good}");
    }
    for bad in ["", "-a", "_a", "A", "office 2", "../etc", "a\0", "ä", "CON", &"m".repeat(64), &"m".repeat(65536)] {
        assert!(matches!(MapName::new(bad), Err(InvalidName::Map(_))), "{bad:?}");
    }
}

#[test]
fn state_names_are_printable_and_unambiguous() {
    for good in ["door", "Küche 2", "房間", "a.b:c", &"ü".repeat(128)] {
        assert!(StateName::new(good).is_ok(), "{good}");
    }
    assert_eq!(StateName::new(""), Err(InvalidName::Empty));
    assert!(matches!(StateName::new(&"ü".repeat(129)), Err(InvalidName::TooLong { chars: 129, .. })));
    assert!(matches!(StateName::new(&"x".repeat(65536)), Err(InvalidName::TooLong { chars: 65536, .. })));
    assert!(matches!(StateName::new("a\nb"), Err(InvalidName::Unprintable { code: 10, .. })));
    assert!(matches!(StateName::new("a\u{202e}b"), Err(InvalidName::Unprintable { .. })));
    assert_eq!(printable("a\n\u{1b}[2Jb\u{202e}\u{9b}é"), "a\\u{a}\\u{1b}[2Jb\\u{202e}\\u{9b}é");
    assert_eq!(printable("Küche 1"), "Küche 1");
    assert!(matches!(StateName::new("u\u{308}"), Err(InvalidName::NotNfc(_))));
    assert!(matches!(StateName::new("edge/a"), Err(InvalidName::Slash(_))));
}

#[test]
fn axes_of_vectors_have_names_that_nobody_can_send() {
    let anna = StateName::new("anna").expect("valid");
    let axis = anna.axis(1);
    assert_eq!((axis.as_str(), axis.as_axis(), anna.as_axis()), ("anna/y", Some(("anna", 1)), None));
    assert!(matches!(StateName::new("anna/y"), Err(InvalidName::Slash(_))));
    assert_eq!(StateName::stored("anna/y"), Ok(axis));
    assert_eq!(StateName::stored("anna"), Ok(anna));
    for bad in ["anna/w", "anna/x/y", "/x", "anna/", "cell/x", "node/x", "a\nb/x"] {
        assert!(StateName::stored(bad).is_err(), "{bad}");
    }
    assert!(StateName::observed("anna/y").is_err());
    let longest = StateName::new(&"ü".repeat(128)).expect("valid").axis(2);
    assert_eq!(StateName::stored(longest.as_str()), Ok(longest));
}

#[test]
fn axes_of_angles_have_names_that_nobody_can_send() {
    let heading = StateName::new("heading").expect("valid");
    let sin = heading.angle_axis(1);
    assert_eq!((sin.as_str(), sin.as_angle_axis(), sin.as_axis()), ("heading/sin", Some(("heading", 1)), None));
    assert_eq!(heading.as_angle_axis(), None);
    assert!(matches!(StateName::new("heading/sin"), Err(InvalidName::Slash(_))));
    assert_eq!(StateName::stored("heading/sin"), Ok(sin));
    for bad in ["heading/tan", "heading/cos/sin", "/cos", "cell/cos", "node/sin", "a\nb/cos"] {
        assert!(StateName::stored(bad).is_err(), "{bad}");
    }
    assert!(StateName::observed("heading/cos").is_err());
}

#[test]
fn the_states_of_a_node_are_renamed_with_it() {
    let to = StateName::new("Hall").expect("valid");
    let renamed = |name: &str| {
        let name = StateName(name.into());
        name.with_node_renamed("Lobby", &to).map(|name| name.map(|name| name.to_string()))
    };
    for (old, new) in [
        ("Lobby", "Hall"),
        ("node/Lobby/Anna", "node/Hall/Anna"),
        ("edge/Lobby/Lab", "edge/Hall/Lab"),
        ("edge/Lab/Lobby", "edge/Lab/Hall"),
        ("speed/Lab/Lobby/drive", "speed/Lab/Hall/drive"),
        ("pace/Lobby/Lobby2", "pace/Hall/Lobby2"),
    ] {
        assert_eq!(renamed(old), Some(Ok(new.to_owned())), "{old}");
    }
    for other in ["Lab", "Lobby2", "Lobby/x", "node/Lab/Lobby", "edge/Lab/Yard/Lobby", "node/x"] {
        assert_eq!(renamed(other), None, "{other}");
    }
    let kind = "k".repeat(119);
    assert_eq!(renamed(&format!("node/Lobby/{}", &kind[..117])).map(|name| name.is_ok()), Some(true));
    let longer = StateName::new("Entrance hall").expect("valid");
    let refused = StateName(format!("node/Lobby/{}", &kind[..117]).into()).with_node_renamed("Lobby", &longer);
    assert!(matches!(refused, Some(Err(InvalidName::TooLong { .. }))), "{refused:?}");
}

#[test]
fn what_is_at_a_node_has_a_name_of_its_own() {
    for good in ["node/Kitchen/Anna", "node/a/x", "plain"] {
        let name = StateName::observed(good).expect("valid");
        assert_eq!((name.as_str(), name.as_axis()), (good, None));
        assert_eq!(StateName::stored(good), Ok(name));
    }
    assert!(StateName::observed("node/a/x").expect("valid").check_vector().is_err());
    let long = format!("node/{}/{}", "n".repeat(70), "k".repeat(70));
    assert_eq!(StateName::observed("node/a"), StateName::new("a"));
    for bad in ["node/", "node//k", "node/a/", "node/a/b/c", "edge/a/b", "node/a\n/b", &long] {
        assert!(StateName::observed(bad).is_err(), "{bad}");
    }
}
