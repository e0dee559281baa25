//! The people of the grid office: their habits, and where each is during a day.
//!
//! Invariant: times are milliseconds on the wall clock of the day; a person's day depends on the seed, the person and
//! the date only, begins after 05:00 and ends before 20:00.

use super::dice::{Dice, DiceTopic};
use crate::civil_day::CivilDay;

pub(crate) const SECOND: i32 = 1000;
pub(crate) const MINUTE: i32 = 60 * SECOND;
pub(crate) const HOUR: i32 = 60 * MINUTE;

/// Number of people in a group that meets every week.
const GROUP: u32 = 6;

/// The place of a person who is away from the desk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AwayPlace {
    Kitchen,
    Meeting,
    Outside,
}

/// A time away from the desk.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Away {
    pub(crate) from: i32,
    pub(crate) to: i32,
    pub(crate) place: AwayPlace,
}

/// A person's day.
#[derive(Clone, Debug, Default)]
pub(crate) struct PersonDay {
    /// Arrival and departure, if the person comes in.
    pub(crate) span: Option<(i32, i32)>,
    /// Times away from the desk between arrival and departure, in order, never overlapping.
    pub(crate) away: Vec<Away>,
}

impl PersonDay {
    /// The times at which the person walks through the building.
    pub(crate) fn moves(&self) -> impl Iterator<Item = i32> + '_ {
        let ends = self.span.into_iter().flat_map(|(from, to)| [from, to]);
        ends.chain(self.away.iter().flat_map(|away| [away.from, away.to]))
    }
}

/// Whether a person comes in on a day.
pub(crate) fn comes_in(seed: u64, person: u32, day: CivilDay) -> bool {
    // Some people work at home on the same day of every week.
    let at_home = Dice::new(seed, DiceTopic::Habits, person, 1).below(14);
    day.open()
        && at_home != day.weekday()
        && !Dice::new(seed, DiceTopic::Leave, person, day.monday()).chance(4)
        && !Dice::new(seed, DiceTopic::Sick, person, day.number).chance(2)
}

/// A person's day.
pub(crate) fn person_day(seed: u64, person: u32, day: CivilDay) -> PersonDay {
    if !comes_in(seed, person, day) {
        return PersonDay::default();
    }
    let mut habit = Dice::new(seed, DiceTopic::Habits, person, 0);
    let arrives = habit.between(7 * HOUR + 45 * MINUTE, 9 * HOUR + 30 * MINUTE);
    let stays = habit.between(8 * HOUR, 9 * HOUR);
    let spread = habit.between(6 * MINUTE, 18 * MINUTE);
    let lunch = habit.between(12 * HOUR, 12 * HOUR + 45 * MINUTE);
    let coffee = habit.between(10 * HOUR, 11 * HOUR);
    let coffee_percent = habit.below(90);

    let mut dice = Dice::new(seed, DiceTopic::PersonDay, person, day.number);
    // On Fridays everybody leaves early.
    let early = if day.weekday() == 4 { 90 * MINUTE } else { 0 };
    let from = dice.around(arrives, spread);
    let to = dice.around(arrives + stays - early, spread).min(19 * HOUR + 45 * MINUTE);

    // More binding appointments come first.
    let mut wishes = meetings(seed, person, day, &mut dice);
    let lunch = dice.around(lunch, 8 * MINUTE);
    let lunch_place = if dice.chance(75) { AwayPlace::Kitchen } else { AwayPlace::Outside };
    wishes.push(Away { from: lunch, to: lunch + dice.around(40 * MINUTE, 5 * MINUTE), place: lunch_place });
    for time in [coffee, coffee + 5 * HOUR] {
        if dice.chance(coffee_percent) {
            let time = dice.around(time, 12 * MINUTE);
            wishes.push(Away {
                from: time,
                to: time + dice.around(10 * MINUTE, 2 * MINUTE),
                place: AwayPlace::Kitchen,
            });
        }
    }
    for _ in 0..dice.below(3) {
        let time = dice.between(from, to);
        wishes.push(Away { from: time, to: time + dice.between(3 * MINUTE, 12 * MINUTE), place: AwayPlace::Outside });
    }

    let mut away: Vec<Away> = Vec::new();
    for wish in wishes {
        let fits = wish.from > from + 5 * MINUTE && wish.to < to - 5 * MINUTE;
        if fits && away.iter().all(|other| wish.to + 3 * MINUTE < other.from || other.to + 3 * MINUTE < wish.from) {
            away.push(wish);
        }
    }
    away.sort_unstable_by_key(|away| away.from);
    PersonDay { span: Some((from, to)), away }
}

/// The weekly meeting of the person's group, always at the same time, and occasional other meetings.
fn meetings(seed: u64, person: u32, day: CivilDay, dice: &mut Dice) -> Vec<Away> {
    let group = person / GROUP;
    let mut habit = Dice::new(seed, DiceTopic::Group, group, 0);
    let weekday = habit.below(5);
    let weekly = habit.between(18, 32) * 30 * MINUTE;
    let mut found = Vec::new();
    let mut meet = |from: i32, to: i32, percent: u32| {
        if dice.chance(percent) {
            let (from, to) = (from + dice.between(-2 * MINUTE, 3 * MINUTE), to + dice.between(0, 4 * MINUTE));
            found.push(Away { from, to, place: AwayPlace::Meeting });
        }
    };
    let mut group_day = Dice::new(seed, DiceTopic::MeetingDay, group, day.number);
    let late = group_day.between(0, 20 * MINUTE);
    if day.weekday() == weekday {
        meet(weekly, weekly + 70 * MINUTE + late, 90);
    }
    if group_day.chance(20) {
        let from = group_day.between(18, 32) * 30 * MINUTE;
        meet(from, from + 25 * MINUTE + late, 70);
    }
    found
}

/// The start of the cleaner; none on evenings without a cleaner. The cleaner always comes on working Fridays, and the
/// round takes less than two hours.
pub(crate) fn cleaner(seed: u64, day: CivilDay) -> Option<i32> {
    let mut dice = Dice::new(seed, DiceTopic::Cleaner, 0, day.number);
    let comes = match day.weekday() {
        0 | 2 => dice.chance(95),
        weekday => weekday == 4,
    };
    (comes && day.open()).then(|| dice.around(20 * HOUR + 30 * MINUTE, 5 * MINUTE))
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    #[test]
    fn days_are_in_order_and_within_bounds() {
        let monday = CivilDay::new(date(2025, 3, 3));
        let mut came = 0;
        for person in 0..40 {
            for day in (0..28).map(|days| monday.plus(days)) {
                let plan = person_day(7, person, day);
                let Some((from, to)) = plan.span else {
                    assert!(plan.away.is_empty());
                    continue;
                };
                came += 1;
                assert!(day.weekday() < 5 && 5 * HOUR < from && from + 4 * HOUR < to && to < 20 * HOUR);
                let mut last = from;
                for away in &plan.away {
                    assert!(last < away.from && away.from < away.to && away.to < to);
                    last = away.to;
                }
            }
        }
        // The number of evenings with a cleaner, of 800 working days.
        assert!((600..800).contains(&came), "{came}");
    }
}
