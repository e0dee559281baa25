//! People come at their rates, and a terminal that learns meets more of them.

use super::{
    visitors::{HOUR_MINUTES, House, SLOT_MINUTES, SLOTS, WORKING_HOURS},
    *,
};

#[test]
fn a_terminal_that_learns_is_used_more_than_one_that_stays() {
    let outcome = run(&TerminalProtocol { seeds: 2, first_seed: 50, weeks: 3 }, &|_, _| {}).expect("robots");
    let per_hour = |kind: TerminalRobotKind| {
        let course = outcome.courses.iter().find(|course| course.kind == kind).expect("a robot");
        course.per_hour(0..3).mean
    };
    let [uniform, learned, best, tidemap, oracle] = TerminalRobotKind::ALL.map(per_hour);
    assert!(tidemap > uniform && tidemap > learned && tidemap > best, "{outcome:?}");
    assert!(oracle > tidemap && best > uniform, "{outcome:?}");
}

#[test]
fn people_come_as_often_as_their_rate() {
    let house = House::new(4);
    let slots = (0..140).flat_map(|day| (0..SLOTS).map(move |slot| (day, slot)));
    let hour = |slot: usize| WORKING_HOURS.start as f64 + (slot * SLOT_MINUTES) as f64 / HOUR_MINUTES as f64;
    for (place, name) in House::places().enumerate() {
        let came: u64 = slots.clone().map(|(day, slot)| house.interactions(place, day, slot, false)).sum();
        let minutes = slots.clone().flat_map(|(day, slot)| {
            let house = &house;
            (0..SLOT_MINUTES).map(move |minute| house.rate(place, day, hour(slot) + minute as f64 / 60.0) / 60.0)
        });
        let expected: f64 = minutes.sum();
        let away = (came as f64 - expected).abs();
        assert!(away < 4.0 * expected.sqrt() + 0.02 * expected, "{name}: {came}, {expected}");
        let moved: u64 = slots.clone().map(|(day, slot)| house.interactions(place, day, slot, true)).sum();
        assert!(moved < came, "{name}: {moved} of {came} while it moves");
    }
}
