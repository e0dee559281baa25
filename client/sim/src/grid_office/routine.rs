//! A thing's routine on one day: its pose at midnight, and each later change of pose.
//!
//! Invariant: depends on the seed, the thing and the date only. Every day begins in the pose in which the day before
//! ended, and nothing happens in its last minute.

use super::{
    dice::{Dice, DiceTopic},
    shapes::{HALF_OPEN, OPEN, POSTURES, SEATED, SECTIONS, SHUT, SPOTS},
    staff::{Away, AwayPlace, HOUR, MINUTE, PersonDay, SECOND, cleaner, comes_in},
    thing_kind::ThingKind,
    things::Thing,
};
use crate::civil_day::CivilDay;

/// The last moment of a day at which anything changes.
pub(crate) const DAY_END: i32 = 24 * HOUR - MINUTE;

/// A day of a thing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Routine {
    /// The pose at midnight.
    pub(crate) start: u8,
    /// Time in milliseconds after midnight, and the pose from then on; by time.
    pub(crate) turns: Vec<(i32, u8)>,
    /// The time in which its cells may flicker, from and until in milliseconds after midnight, and the factor on the
    /// flicker rate.
    pub(crate) lively: Option<(i32, i32, f64)>,
}

/// Working hours, in which the cells of most things flicker. The factor 1.4 makes up for the 2 days of 7 without work.
const WORKING: (i32, i32, f64) = (8 * HOUR, 18 * HOUR + 30 * MINUTE, 1.4);

/// The routine of a thing on a day, given the days of all people.
pub(crate) fn routine(seed: u64, index: u32, thing: &Thing, day: CivilDay, staff: &[PersonDay]) -> Routine {
    let people: Vec<&PersonDay> = thing.people.iter().filter_map(|&person| staff.get(person as usize)).collect();
    let cleaned = cleaner(seed, day).map(|start| start + (index % 48).cast_signed() * 2 * MINUTE);
    let mut dice = Dice::new(seed, DiceTopic::ThingDay, index, day.number);
    let mut habit = Dice::new(seed, DiceTopic::ThingHabit, index, 0);
    let mut start = 0;
    let mut lively = day.open().then_some(WORKING);
    let mut turns = match thing.kind {
        ThingKind::Workplace => {
            let owner = thing.people[0];
            start = chair_at_midnight(seed, owner, day);
            lively = people[0].span.map(|(from, to)| (from, to, 1.6));
            workplace(seed, owner, day, people[0], cleaned, &mut dice)
        }
        ThingKind::Belongings => people[0].span.map_or_else(Vec::new, |(from, to)| vec![(from, OPEN), (to, SHUT)]),
        ThingKind::Door => door(&people, cleaned, habit.chance(65), &mut dice),
        ThingKind::Curtain => curtain(&people, &mut dice),
        ThingKind::Way => way(&people, cleaned, &mut dice),
        ThingKind::Kitchen => gathering(&people, AwayPlace::Kitchen),
        ThingKind::Meeting => gathering(&people, AwayPlace::Meeting),
        ThingKind::Parcel => {
            let (before, after) = (parcel(seed, index, day.plus(-1)), parcel(seed, index, day));
            start = before;
            if before == after { Vec::new() } else { vec![(dice.between(9 * HOUR, 17 * HOUR), after)] }
        }
        ThingKind::Edge => {
            lively = Some((MINUTE, DAY_END, 1.0));
            Vec::new()
        }
        ThingKind::DaylightEdge => Vec::new(),
    };
    turns.retain(|&(time, _)| time < DAY_END);
    turns.sort_by_key(|&(time, _)| time);
    Routine { start, turns, lively }
}

/// The pose in which a person leaves the chair when leaving the building.
fn left_chair(seed: u64, person: u32, day: CivilDay) -> u8 {
    let mut dice = Dice::new(seed, DiceTopic::LeftChair, person, day.number);
    if dice.chance(75) { 0 } else { 1 + dice.below(u32::from(SEATED) - 1) as u8 }
}

/// The pose of the chair when a day begins.
fn chair_at_midnight(seed: u64, person: u32, day: CivilDay) -> u8 {
    // The cleaner comes on every working Friday, so the search ends within 60 days.
    for past in (1..=60).map(|days| day.plus(-days)) {
        if cleaner(seed, past).is_some() {
            return 0;
        }
        if comes_in(seed, person, past) {
            return left_chair(seed, person, past);
        }
    }
    0
}

fn workplace(
    seed: u64,
    person: u32,
    day: CivilDay,
    plan: &PersonDay,
    cleaned: Option<i32>,
    dice: &mut Dice,
) -> Vec<(i32, u8)> {
    let mut turns = Vec::new();
    if let Some((mut from, leaves)) = plan.span {
        let leaving = Away { from: leaves, to: leaves, place: AwayPlace::Outside };
        for away in plan.away.iter().chain([&leaving]) {
            while from < away.from {
                // Upright half of the time.
                let posture = if dice.chance(50) { 0 } else { dice.below(u32::from(POSTURES)) as u8 };
                turns.push((from, SEATED + posture));
                from += dice.between(8 * MINUTE, 40 * MINUTE);
            }
            let pushed = if dice.chance(60) { 1 } else { dice.below(u32::from(SEATED)) as u8 };
            turns.push((away.from, pushed));
            from = away.to;
        }
        turns.push((leaves, left_chair(seed, person, day)));
    }
    turns.extend(cleaned.map(|time| (time, 0)));
    turns
}

/// First arrival and last departure.
fn occupied(people: &[&PersonDay]) -> Option<(i32, i32)> {
    let spans = people.iter().filter_map(|person| person.span);
    spans.reduce(|all, span| (all.0.min(span.0), all.1.max(span.1)))
}

/// Some doors stand open while anybody is in, except during calls; the others are shut except when a person passes.
fn door(people: &[&PersonDay], cleaned: Option<i32>, stands_open: bool, dice: &mut Dice) -> Vec<(i32, u8)> {
    let mut turns = Vec::new();
    if let Some((first, last)) = occupied(people) {
        if stands_open {
            turns.extend([(first, OPEN), (last, SHUT)]);
            let mut time = first + dice.between(HOUR, 5 * HOUR);
            while time + HOUR < last {
                let until = time + dice.between(15 * MINUTE, 40 * MINUTE);
                turns.extend([(time, SHUT), (until, OPEN)]);
                time = until + dice.between(2 * HOUR, 6 * HOUR);
            }
        } else {
            for time in people.iter().flat_map(|person| person.moves()) {
                turns.extend([(time, OPEN), (time + dice.between(8 * SECOND, 30 * SECOND), SHUT)]);
            }
        }
    }
    if let Some(time) = cleaned {
        turns.extend([(time, OPEN), (time + dice.between(5 * MINUTE, 12 * MINUTE), SHUT)]);
    }
    turns
}

/// A curtain is opened in the morning and drawn by the last person to leave. On some afternoons it is half drawn
/// against the sun.
fn curtain(people: &[&PersonDay], dice: &mut Dice) -> Vec<(i32, u8)> {
    let Some((first, last)) = occupied(people).filter(|_| dice.chance(85)) else { return Vec::new() };
    let mut turns = vec![(first + dice.between(MINUTE, 20 * MINUTE), OPEN), (last, SHUT)];
    let sun = dice.around(14 * HOUR, 20 * MINUTE);
    if dice.chance(40) && sun + 3 * HOUR < last {
        turns.extend([(sun, HALF_OPEN), (sun + dice.around(90 * MINUTE, 15 * MINUTE), OPEN)]);
    }
    turns
}

/// People walk along a way in both directions, one at a time.
fn way(people: &[&PersonDay], cleaned: Option<i32>, dice: &mut Dice) -> Vec<(i32, u8)> {
    let mut starts: Vec<(i32, i32)> = people.iter().flat_map(|person| person.moves()).map(|time| (time, 7)).collect();
    starts.extend(cleaned.map(|time| (time, 60)));
    starts.sort_unstable();
    let mut turns: Vec<(i32, u8)> = Vec::new();
    for (start, seconds) in starts {
        let busy = turns.last().is_some_and(|&(end, _)| start < end + 7 * SECOND);
        if busy || dice.chance(20) {
            continue;
        }
        let forward = dice.chance(50);
        let mut time = start;
        for section in 0..SECTIONS {
            turns.push((time, 1 + if forward { section } else { SECTIONS - 1 - section }));
            time += dice.between(seconds * SECOND, 2 * seconds * SECOND);
        }
        turns.push((time, 0));
    }
    turns
}

/// The number of people at a place where they gather.
fn gathering(people: &[&PersonDay], place: AwayPlace) -> Vec<(i32, u8)> {
    let stays = people.iter().flat_map(|person| &person.away).filter(|away| away.place == place);
    let mut steps: Vec<(i32, i8)> = stays.flat_map(|away| [(away.from, 1), (away.to, -1)]).collect();
    steps.sort_unstable();
    let mut count = 0_i8;
    let step = |(time, step): (i32, i8)| {
        count += step;
        (time, count.unsigned_abs().min(SPOTS))
    };
    steps.into_iter().map(step).collect()
}

/// 1 if a parcel stands there at the end of a day.
fn parcel(seed: u64, index: u32, day: CivilDay) -> u8 {
    // A parcel stays or is absent for spells of 3 to 9 days.
    let mut habit = Dice::new(seed, DiceTopic::Parcel, index, 0);
    let (length, offset) = (habit.between(3, 10), habit.between(0, 10));
    let spell = (day.number + offset).div_euclid(length);
    u8::from(Dice::new(seed, DiceTopic::Parcel, index, spell).chance(15))
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;
    use crate::grid_office::staff::person_day;

    const KINDS: [ThingKind; 10] = [
        ThingKind::Workplace,
        ThingKind::Belongings,
        ThingKind::Door,
        ThingKind::Curtain,
        ThingKind::Way,
        ThingKind::Kitchen,
        ThingKind::Meeting,
        ThingKind::Parcel,
        ThingKind::Edge,
        ThingKind::DaylightEdge,
    ];

    #[test]
    fn days_continue_where_the_day_before_ended() {
        // Over New Year, with its holidays.
        let first = CivilDay::new(date(2025, 11, 20));
        for (index, kind) in (0..).zip(KINDS.iter().cycle().take(60)) {
            let thing = Thing { kind: *kind, people: vec![index % 7, 3] };
            let mut pose = None;
            for day in (0..60).map(|days| first.plus(days)) {
                let staff: Vec<_> = (0..7).map(|person| person_day(5, person, day)).collect();
                let Routine { start, turns, .. } = routine(5, index, &thing, day, &staff);
                assert!(pose.is_none_or(|pose| pose == start), "{kind:?} {index} on day {}", day.number);
                assert!(turns.is_sorted_by_key(|&(time, _)| time));
                assert!(turns.iter().all(|&(time, pose)| (1..DAY_END).contains(&time) && pose < 16));
                pose = Some(turns.last().map_or(start, |&(_, pose)| pose));
            }
        }
    }
}
