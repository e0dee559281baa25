//! Tests which edits of a site are applied, and which are refused. Invariant: a refused edit changes nothing.

use super::*;

fn name(name: &str) -> StateName {
    StateName::new(name).expect("valid")
}

fn location(states: &[u32]) -> Location {
    let states = states.iter().map(|&id| StateId(id)).collect();
    Location { states, cells: Vec::new(), position_m: Some([1.0, -2.0]) }
}

#[test]
fn a_location_is_set_replaced_and_removed() {
    let mut site = Site::default();
    assert!(site.is_empty());
    let set = |states: &[u32]| SiteEdit::SetLocation(name("kitchen"), location(states));
    site.apply(&set(&[0, 2]), 3).expect("valid");
    site.apply(&set(&[1]), 3).expect("valid");
    assert_eq!(site.locations().get(&name("kitchen")), Some(&location(&[1])));
    site.apply(&SiteEdit::RemoveLocation(name("kitchen")), 3).expect("valid");
    assert!(site.is_empty());
}

#[test]
fn a_location_may_have_cells_each_once_and_as_many_as_states() {
    let cell = |x| CellIndex { x, y: -2, z: 7 };
    let set = |cells: Vec<CellIndex>, states: &[u32]| {
        SiteEdit::SetLocation(name("desk"), Location { cells, ..location(states) })
    };
    let mut site = Site::default();
    site.apply(&set(vec![cell(-3), cell(4)], &[]), 0).expect("cells alone");
    for cells in [vec![cell(4), cell(-3)], vec![cell(4), cell(4)]] {
        assert_eq!(site.apply(&set(cells, &[]), 0), Err(InvalidEdit::States("desk".to_owned())));
    }
    let many: Vec<CellIndex> = (0..4096).map(cell).collect();
    site.apply(&set(many.clone(), &[]), 1).expect("as many as may be");
    let refused = InvalidEdit::TooManyStates { name: "desk".to_owned(), got: 4097, max: 4096 };
    assert_eq!(site.apply(&set(many, &[0]), 1), Err(refused));
}

#[test]
fn a_charger_is_set_and_forgotten() {
    let mut site = Site::default();
    site.apply(&SiteEdit::Charger(Some([0.5, 2.0])), 0).expect("valid");
    assert_eq!(site.charger_m(), Some([0.5, 2.0]));
    site.apply(&SiteEdit::Charger(None), 0).expect("valid");
    assert!(site.is_empty());
}

#[test]
fn visits_are_counted_where_they_were() {
    let mut site = Site::default();
    for reached in [true, false, false, true] {
        site.apply(&SiteEdit::Visit { at_m: [1.2, -3.4], reached, utc_nanos: 5 }, 0).expect("valid");
    }
    let rate = site.reachability().rate(1.4, -3.1);
    assert_eq!((rate.rate, rate.attempts), (0.5, 4));
    let far = SiteEdit::Visit { at_m: [f64::NAN, 0.0], reached: true, utc_nanos: 5 };
    assert!(matches!(site.apply(&far, 0), Err(InvalidEdit::Visit(_))));
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut site = Site::default();
    site.apply(&SiteEdit::SetLocation(name("kitchen"), location(&[0])), 2).expect("valid");
    let before = site.clone();
    let set = |states: &[u32]| SiteEdit::SetLocation(name("lab"), location(states));
    for (edit, expected) in [
        (set(&[]), InvalidEdit::NoStates("lab".to_owned())),
        (set(&[2]), InvalidEdit::States("lab".to_owned())),
        (set(&[1, 1]), InvalidEdit::States("lab".to_owned())),
        (set(&[1, 0]), InvalidEdit::States("lab".to_owned())),
        (SiteEdit::RemoveLocation(name("lab")), InvalidEdit::UnknownLocation("lab".to_owned())),
        (SiteEdit::Charger(Some([0.0, f64::INFINITY])), InvalidEdit::Coordinate(f64::INFINITY)),
    ] {
        assert_eq!(site.apply(&edit, 2), Err(expected));
    }
    assert!(matches!(site.apply(&SiteEdit::Charger(Some([f64::NAN, 0.0])), 2), Err(InvalidEdit::Coordinate(_))));
    let many: Vec<u32> = (0..=4_096).collect();
    assert!(matches!(site.apply(&set(&many), 9_999), Err(InvalidEdit::TooManyStates { got: 4_097, .. })));
    assert_eq!(site, before);
}
