//! The worlds have the documented habits and readings, the scores agree with hand-made cases, and a map predicts before
//! it learns.

use std::collections::BTreeMap;

use jiff::civil::{Date, date};
use tidemap_formats::table::Format;
use tidemap_model::{HeldInterval, catalogue::ModelKind, models::Interval};

use super::{
    calendar::{Calendar, FIRST, HabitStep, SEC_NANOS},
    world::Look,
    *,
};

const SEEDS: u64 = 6;

fn named(name: &str) -> &'static Habit {
    Habit::named(name).expect("a habit")
}

fn worlds(name: &str) -> Vec<HabitWorld> {
    (0..SEEDS).map(|seed| HabitWorld::new(named(name), seed).expect("a zone")).collect()
}

/// The share of steps with a 1 between two hours of the days of a kind.
fn share(worlds: &[HabitWorld], hours: std::ops::Range<f64>, is_day: impl Fn(&calendar::HabitDay) -> bool) -> f64 {
    let of_world = |world: &HabitWorld| {
        let calendar = &world.calendar;
        let is_wanted = |step: &HabitStep| hours.contains(&step.hour) && is_day(&calendar.days[step.day]);
        let steps = calendar.steps.iter().zip(&world.values).filter(|(step, _)| is_wanted(step));
        steps.fold((0_u32, 0_u32), |(ones, all), (_, &value)| (ones + u32::from(value), all + 1))
    };
    let (ones, all) = worlds.iter().map(of_world).fold((0, 0), |sum, own| (sum.0 + own.0, sum.1 + own.1));
    assert!(all > 0, "no step at {hours:?}");
    f64::from(ones) / f64::from(all)
}

#[track_caller]
fn about(found: f64, expected: f64) {
    assert!((found - expected).abs() < 0.05, "{found} instead of {expected}");
}

#[test]
fn days_follow_the_clocks_of_london() {
    let calendar = Calendar::until(date(2026, 4, 1)).expect("a zone");
    assert_eq!((calendar.days[0].date, calendar.days[0].weekday), (FIRST, 0));
    assert_eq!(calendar.steps[0].utc_nanos, 1_756_681_200 * SEC_NANOS, "2025-08-31T23:00Z");
    let steps = |day: Date| calendar.days[calendar.number_of(day)].steps.len();
    assert_eq!(steps(date(2025, 10, 26)), 150, "clocks go back");
    assert_eq!(steps(date(2026, 3, 29)), 138, "clocks go forward");
    assert_eq!(steps(date(2026, 1, 1)), 144);
    for hour in calendar.steps.chunks(HOUR_STEPS) {
        assert!(hour[0].hour.fract() == 0.0 && hour.iter().all(|step| step.hour.floor() == hour[0].hour), "{hour:?}");
    }
    let monday = calendar.days[7].steps.start;
    assert_eq!((calendar.hour_of_week(monday), calendar.hour_of_week(monday - 1)), (0, 167));
}

#[test]
fn a_world_is_that_of_its_habit_and_seed() {
    let world = |name: &str, seed: u64| HabitWorld::new(named(name), seed).expect("a zone");
    let (first, again, other) = (world("office", 3), world("office", 3), world("office", 4));
    assert_eq!((&first.values, &first.looks), (&again.values, &again.looks));
    assert_ne!(first.values, other.values);
    assert_ne!(first.values, world("classes", 3).values);
}

#[test]
fn states_are_1_as_often_as_in_their_habit() {
    let (weekday, any) = (|day: &calendar::HabitDay| !day.is_weekend(), |_: &calendar::HabitDay| true);
    let office = worlds("office");
    about(share(&office, 10.0..11.5, weekday), 0.8);
    about(share(&office, 12.2..13.0, weekday), 0.4);
    about(share(&office, 20.0..24.0, weekday), 0.02);
    about(share(&office, 10.0..11.5, calendar::HabitDay::is_weekend), 0.02);
    // After midnight, too.
    let bar = worlds("bar");
    about(share(&bar, 21.0..24.0, |day| day.weekday == 4), 0.95);
    about(share(&bar, 0.0..2.0, |day| day.weekday == 6), 0.95);
    about(share(&bar, 0.0..2.0, |day| day.weekday == 4), 0.01);
    about(share(&worlds("noise"), 0.0..8.0, any), 0.1);
    about(share(&worlds("noise"), 9.0..17.0, weekday), 0.9);
    let shifts = worlds("shifts");
    about(share(&shifts, 8.0..19.0, |day| day.number % 14 == 6), 0.9);
    about(share(&shifts, 8.0..19.0, |day| day.number % 14 == 7), 0.03);
    let mondays = worlds("first-mondays");
    about(share(&mondays, 9.0..18.0, |day| day.weekday == 0 && day.date.day() <= 7), 0.01);
    about(share(&mondays, 9.0..18.0, |day| day.weekday == 0 && day.date.day() > 7), 0.97);
    let classes = worlds("classes");
    about(share(&classes, 10.2..12.0, |day| day.weekday == 3), 0.95);
    about(share(&classes, 12.5..14.0, |day| day.weekday == 3), 0.02);
    assert!(share(&worlds("rare"), 0.0..24.0, any) < 0.01);
}

#[test]
fn habits_follow_the_year_and_the_clocks() {
    let in_month = |month: i8| move |day: &calendar::HabitDay| day.date.month() == month;
    let light = worlds("daylight");
    about(share(&light, 17.0..20.0, in_month(12)), 0.93);
    about(share(&light, 17.0..20.0, in_month(5)), 0.03);
    let ramadan = worlds("ramadan");
    about(share(&ramadan, 0.0..2.0, |day| (date(2026, 2, 20)..date(2026, 3, 19)).contains(&day.date)), 0.9);
    about(share(&ramadan, 0.0..2.0, in_month(4)), 0.02);
    let semester = worlds("semester");
    about(share(&semester, 10.5..16.0, |day| day.date.month() == 11 && !day.is_weekend()), 0.85);
    about(share(&semester, 10.5..16.0, |day| day.date.day() > 22 && day.date.month() == 12 && !day.is_weekend()), 0.15);
    let change = worlds("change");
    about(share(&change, 9.0..12.0, |day| day.date.month() == 11 && !day.is_weekend()), 0.85);
    about(share(&change, 9.0..12.0, |day| day.date.month() == 12 && !day.is_weekend()), 0.02);
    // At the same local hour in winter and in summer.
    let clocks = worlds("clocks");
    for month in [3, 4] {
        about(share(&clocks, 8.0..9.0, |day| day.date.month() == month && !day.is_weekend()), 0.95);
        about(share(&clocks, 7.0..8.0, |day| day.date.month() == month && !day.is_weekend()), 0.01);
    }
}

#[test]
fn robots_look_when_they_should() {
    let world = |name: &str| HabitWorld::new(named(name), 1).expect("a zone");
    let office = world("office");
    assert_eq!(office.looks.len(), office.calendar.steps.len() / 3);
    for world in [&office, &world("bursts")] {
        for Look { step, sample } in &world.looks {
            let start = world.calendar.steps[*step];
            let secs = (sample.utc_nanos - start.utc_nanos) / SEC_NANOS;
            assert!((0..600).contains(&secs), "{secs}");
            assert_eq!((sample.value == 1.0, sample.offset_secs), (world.values[*step], start.offset_secs));
        }
        assert!(world.looks.is_sorted_by_key(|look| look.sample.utc_nanos));
        let by_day: usize = (0..world.calendar.days.len()).map(|day| world.looks_of(day).len()).sum();
        assert_eq!(by_day, world.looks.len(), "each look belongs to one day");
    }
    assert!(office.looks.windows(2).all(|two| two[1].sample.utc_nanos - two[0].sample.utc_nanos == 1800 * SEC_NANOS));

    let bursts = world("bursts");
    for day in 0..bursts.calendar.days.len() {
        let looks = bursts.looks_of(day);
        assert_eq!(looks.len(), 3600);
        assert!(looks.windows(2).all(|two| two[1].sample.utc_nanos - two[0].sample.utc_nanos == SEC_NANOS));
        let hour = bursts.calendar.steps[looks[0].step].hour;
        assert!((7.0..20.0).contains(&hour), "{hour}");
    }

    let few = world("three-looks");
    let mut weeks: BTreeMap<usize, usize> = BTreeMap::new();
    for day in 0..few.calendar.days.len() {
        let looks = few.looks_of(day);
        assert!(looks.len() <= 1, "{looks:?}");
        for look in looks {
            assert!((7.0..21.0).contains(&few.calendar.steps[look.step].hour));
            *weeks.entry(day / 7).or_default() += 1;
        }
    }
    let whole = few.calendar.days.len() / 7;
    assert!((0..whole).all(|week| weeks[&week] == 3), "{weeks:?}");

    let gap = world("gap");
    let looks_on = |day: Date| gap.looks_of(gap.calendar.number_of(day)).len();
    assert_eq!((looks_on(date(2025, 11, 2)), looks_on(date(2025, 11, 3))), (48, 0));
    assert_eq!((looks_on(date(2026, 1, 18)), looks_on(date(2026, 1, 19))), (0, 48));
}

#[test]
fn baselines_are_the_means_of_what_was_seen() {
    let calendar = Calendar::until(date(2025, 9, 14)).expect("a zone");
    let mut baselines = Baselines::new(&calendar);
    let step_at = |day: usize, hour: usize| calendar.days[day].steps.start + hour * HOUR_STEPS;
    let look = |day: usize, hour: usize, value: f64| {
        let step = step_at(day, hour);
        let HabitStep { utc_nanos, offset_secs, .. } = calendar.steps[step];
        Look { step, sample: tidemap_model::Sample { utc_nanos, offset_secs, value } }
    };
    assert_eq!(baselines.predict(&calendar, step_at(0, 9), 1), [0.5; BASELINES.len()]);
    // Monday and Tuesday: 1 at nine, 0 at ten.
    for day in 0..2 {
        baselines.learn(&calendar, &[look(day, 9, 1.0), look(day, 10, 0.0)]);
    }
    let close = |found: [f64; BASELINES.len()], expected: [f64; BASELINES.len()]| {
        let is_close = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-9);
        assert!(is_close, "{found:?} instead of {expected:?}");
    };
    // The mean of all readings is 1/2. A reading fades by 2^(-1/21) a day.
    let faded = 0.5_f64.powf(1.0 / 21.0);
    close(baselines.predict(&calendar, step_at(7, 9), 1), [2.0 / 3.0, 0.75, (faded + 0.5) / (faded + 1.0), 0.98, 0.5]);
    close(baselines.predict(&calendar, step_at(2, 10), 1), [0.5, 0.25, 0.5, 0.5, 0.02]);
    // A reading counts as yesterday's for the steps of half an hour around it.
    close(baselines.predict(&calendar, step_at(2, 10) + 3, 1), [0.5, 0.25, 0.5, 0.5, 0.02]);
    close(baselines.predict(&calendar, step_at(2, 10) + 4, 1), [0.5, 0.25, 0.5, 0.5, 0.5]);
}

#[test]
fn scores_are_those_of_hand_made_predictions() {
    let mut scores = Scores::default();
    scores.auto.add(0.8, true);
    scores.auto.add(0.0, true);
    assert!((scores.auto.mse() - (0.04 + 1.0) / 2.0).abs() < 1e-12);
    assert!((scores.auto.log_loss() - (-(0.8_f64.ln()) - 0.001_f64.ln()) / 2.0).abs() < 1e-12);
    for (index, errors) in scores.baselines.iter_mut().enumerate() {
        errors.add(0.5, index == 0);
    }
    scores.baselines[4] = Errors::default();
    scores.baselines[4].add(0.1, false);
    assert!((scores.mse_of_best() - (0.52 / 0.01 - 1.0)).abs() < 1e-9);
    assert!((scores.log_loss_of_best() - (scores.auto.log_loss() / -(0.9_f64.ln()) - 1.0)).abs() < 1e-9);

    let mut held = HourClaims::default();
    assert_eq!((held.held(), held.claimed()), (None, None));
    let interval = |lower, upper, mass| HeldInterval { interval: Interval { lower, upper }, mass };
    held.add(&interval(0.2, 0.5, 0.6), 0.5);
    held.add(&interval(0.2, 0.5, 0.8), 4.0 / 6.0);
    assert_eq!(held.held(), Some(0.5));
    assert!((held.claimed().expect("hours") - 0.7).abs() < 1e-12);

    let mut sure = Sure::default();
    assert_eq!((sure.share(), sure.wrong()), (0.0, None));
    for (p, value) in [(0.005, false), (0.995, false), (0.5, true), (0.01, true)] {
        sure.add(0.01, p, value);
    }
    assert_eq!((sure.share(), sure.wrong()), (0.5, Some(0.5)));

    let mut twice = scores;
    twice.join(&scores);
    assert!((twice.auto.mse() - scores.auto.mse()).abs() < 1e-12 && twice != scores);
}

#[test]
fn the_map_learns_as_that_of_a_daemon_does() {
    let world = HabitWorld::new(named("office"), 0).expect("a zone");
    let first_nanos = world.calendar.steps[0].utc_nanos;
    let mut learner = HabitLearner::new(world.calendar.zone.clone(), first_nanos).expect("a map");
    for day in 0..21 {
        let midnight_nanos = world.calendar.steps[world.calendar.days[day].steps.end].utc_nanos;
        learner.learn(world.looks_of(day), midnight_nanos).expect("a night");
    }
    let view = learner.view();
    let model = view.model(learner::STATE);
    assert_eq!((view.generation(), view.pending(), model.accumulator().observations()), (21, 0, 21 * 48));
    let trained = model.alternatives().expect("a learned state").trained(ModelKind::Calibrated);
    assert!(trained.is_some(), "models are trained on the history of earlier nights");
    assert!(model.ensemble().is_some(), "an ensemble answers");
}

#[test]
fn a_new_bar_is_predicted_before_it_is_learned() {
    let protocol =
        HabitsProtocol { seeds: 2, first_seed: 5, ahead_days: 1, habits: vec![named("new-noise"), named("new-bar")] };
    let outcome = run(&protocol, &|_, _| {}).expect("a run");
    let names: Vec<&str> = outcome.habits.iter().map(|row| row.habit.name).collect();
    assert_eq!(names, ["new-bar", "new-noise"], "in the order of all habits");
    for HabitScores { habit, scores } in &outcome.habits {
        let (auto, truth) = (scores.auto.mse(), scores.truth.mse());
        // No model can know the draws, and none is as bad as one that always predicts the opposite.
        assert!(truth < auto && auto < 0.2, "{}: {auto}, the truth {truth}", habit.name);
        assert!(scores.mse_of_best() < 0.5, "{}: {}", habit.name, scores.mse_of_best());
        let claimed: Vec<f64> = scores.held.iter().filter_map(HourClaims::claimed).collect();
        assert!(claimed.len() == LEVELS.len() && claimed.is_sorted(), "wider intervals hold more: {claimed:?}");
        assert!(claimed.iter().zip(LEVELS).all(|(&claimed, level)| claimed >= level - 1e-9), "{claimed:?}");
    }

    let mut table = Vec::new();
    summary(&outcome, Format::Csv, &mut table).expect("memory can be written");
    let table = String::from_utf8(table).expect("text");
    let names: Vec<&str> = table.lines().filter_map(|line| line.split(',').next()).collect();
    assert_eq!(names, ["habit", "new-bar", "new-noise", "all"]);
    let mse = |line: usize| -> f64 {
        let cell = table.lines().nth(line).and_then(|line| line.split(',').nth(1)).expect("a cell");
        cell.parse().expect("a number")
    };
    assert!((mse(3) - (mse(1) + mse(2)) / 2.0).abs() < 1e-12, "{table}");

    let again = run(&protocol, &|_, _| {}).expect("a run");
    assert!(outcome.habits.iter().zip(&again.habits).all(|(one, other)| one.scores == other.scores));
}
