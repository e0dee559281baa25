//! The office has rooms with entrances, and people with regular habits.

use super::*;

const HOUR: i64 = 3600;

#[test]
fn the_office_of_the_paper_has_twenty_things_that_move_on_twenty_metres() {
    let office = ExploredOffice::new(1, 4);
    assert_eq!((office.moving(), office.size()), (20, [101, 61, 12]));
    let (a, b) = (office.occupied(11 * HOUR), ExploredOffice::new(1, 4).occupied(11 * HOUR));
    assert_eq!(a, b);
    assert_ne!(a, ExploredOffice::new(2, 4).occupied(11 * HOUR));
}

#[test]
fn nobody_is_there_at_night_and_days_differ_a_little() {
    let office = ExploredOffice::new(3, 4);
    let night = office.occupied(2 * HOUR);
    assert_eq!(night, office.occupied(4 * DAY_SECS + 23 * HOUR));
    let differ = |one: &[bool], other: &[bool]| one.iter().zip(other).filter(|(one, other)| one != other).count();
    let noon = |day: i64| office.occupied(day * DAY_SECS + 11 * HOUR + HOUR / 2);
    assert!(differ(&night, &noon(0)) > 300, "{}", differ(&night, &noon(0)));
    let between_days: usize = (1..5).map(|day| differ(&noon(0), &noon(day))).sum::<usize>() / 4;
    assert!(between_days < differ(&night, &noon(0)) / 2, "{between_days}");
    let changes: usize =
        (0..96).map(|slot| differ(&office.occupied(slot * 900), &office.occupied((slot + 1) * 900))).sum();
    assert!(changes > 1000, "{changes}");
}

#[test]
fn the_charger_is_free_and_every_room_has_a_way_in() {
    for rooms in [0, 2, 4] {
        let office = ExploredOffice::new(1, rooms);
        let cells = office.occupied(12 * HOUR);
        let [width, depth, _] = office.size();
        let [x, y] = office.charger_m().map(|metres| (metres / ExploredOffice::CELL_M) as usize);
        assert!((0..HEIGHT).all(|z| !cells[(z * depth + y) * width + x]));
        // At a height of one metre all free cells are connected.
        let free = |x: usize, y: usize| !cells[(5 * depth + y) * width + x];
        let mut reached = vec![false; width * depth];
        let mut next = vec![(x, y)];
        while let Some((x, y)) = next.pop() {
            if free(x, y) && !std::mem::replace(&mut reached[y * width + x], true) {
                next.extend([(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]);
            }
        }
        for index in 0..2 * office.rooms_a_side {
            let middle = office.room(index).block(11..12, 10..11, 5..6);
            assert!(reached[middle.from[1] * width + middle.from[0]], "room {index}");
        }
    }
}
