//! Tests windows and figures, and which edits a book of tasks accepts.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::name::TaskName;

const HOUR: u32 = 3_600;
const HOUR_NANOS: i64 = 3_600_000_000_000;

fn name(kind: &str, node: &str) -> TaskName {
    TaskName::new(kind, node).unwrap()
}

fn task() -> RobotTask {
    RobotTask {
        name: name("clean", "hall"),
        from_secs: 8 * HOUR,
        until_secs: 13 * HOUR,
        duration_secs: 600,
        days: TaskDays::Weekly(0b1_1111),
        every_secs: None,
        value: 2.0,
        value_state: None,
    }
}

/// The day 2016-03-21 is a Monday.
const MONDAY: LocalDay = LocalDay(16_881);

#[test]
fn windows_follow_days_and_repetitions() {
    assert_eq!(MONDAY.to_string(), "2016-03-21");
    assert_eq!(task().windows(MONDAY), [(8 * HOUR, 13 * HOUR)]);
    assert_eq!(task().windows(LocalDay(MONDAY.0 + 5)), []);
    let once = RobotTask { days: TaskDays::On(LocalDay(MONDAY.0 + 5)), ..task() };
    assert_eq!((once.windows(MONDAY).len(), once.windows(LocalDay(MONDAY.0 + 5)).len()), (0, 1));
    let often = RobotTask { every_secs: Some(2 * HOUR), ..task() };
    let parts = [(8 * HOUR, 10 * HOUR), (10 * HOUR, 12 * HOUR), (12 * HOUR, 13 * HOUR)];
    assert_eq!(often.windows(MONDAY), parts);
    // The rest of the window is too short for the task.
    let long = RobotTask { duration_secs: HOUR + 1, ..often };
    assert_eq!(long.windows(MONDAY), parts[..2]);
}

#[test]
fn invalid_tasks_are_refused_by_name() {
    assert_eq!(task().check(), Ok(()));
    for (wrong, words) in [
        (RobotTask { from_secs: 13 * HOUR, ..task() }, "the window"),
        (RobotTask { until_secs: 25 * HOUR, ..task() }, "the window"),
        (RobotTask { duration_secs: 0, ..task() }, "takes 0 s"),
        (RobotTask { duration_secs: 6 * HOUR, ..task() }, "takes 21600 s"),
        (RobotTask { every_secs: Some(60), ..task() }, "every 60 s"),
        (RobotTask { duration_secs: 1, every_secs: Some(2), ..task() }, "every 2 s"),
        (RobotTask { days: TaskDays::Weekly(0), ..task() }, "no day"),
        (RobotTask { value: -1.0, ..task() }, "value"),
        (RobotTask { value: f64::NAN, ..task() }, "value"),
    ] {
        let text = wrong.check().unwrap_err().to_string();
        assert!(text.contains(words), "{text}");
    }
}

#[test]
fn a_time_of_day_is_the_clock_on_the_wall() {
    let zone = Zone::named("Europe/London").unwrap();
    // The clocks go forward on 27 March 2016 at 1 o'clock.
    let jump = LocalDay(MONDAY.0 + 6);
    let before = local_nanos(&zone, jump, HOUR / 2);
    assert_eq!(local_nanos(&zone, jump, 9 * HOUR) - before, 15 * HOUR_NANOS / 2);
    assert_eq!(local_nanos(&zone, jump, 3 * HOUR / 2) - before, HOUR_NANOS, "01:30 does not exist: 02:30");
    let usual = LocalDay(MONDAY.0 + 7);
    assert_eq!(local_nanos(&zone, usual, 9 * HOUR) - local_nanos(&zone, jump, 9 * HOUR), 24 * HOUR_NANOS);
    assert_eq!(local_nanos(&zone, usual, 24 * HOUR), zone.midnight_nanos(LocalDay(usual.0 + 1)));
}

fn run(kind: &str, hours: (i64, i64), success: bool) -> TaskRun {
    let midnight = i64::from(MONDAY.0) * 24 * HOUR_NANOS;
    TaskRun {
        name: name(kind, "hall"),
        start_nanos: midnight + hours.0 * HOUR_NANOS,
        end_nanos: midnight + hours.1 * HOUR_NANOS,
        success,
        intervention: false,
        reason: String::new(),
    }
}

#[test]
fn figures_are_those_of_the_paper() {
    let mut runs = TaskRuns::default();
    assert_eq!(task_weeks(&runs, &Zone::utc(), AllowedHours::default()), []);
    for added in [
        run("clean", (9, 11), true),
        run("guide", (10, 12), true),
        run("charge", (12, 14), true),
        // This task is partly after hours.
        run("clean", (17, 20), false),
        TaskRun { intervention: true, ..run("clean", (24 + 9, 24 + 10), false) },
        // The next lifetime goes on into the next week.
        run("clean", (6 * 24 + 10, 6 * 24 + 11), true),
        run("clean", (7 * 24 + 9, 7 * 24 + 10), true),
    ] {
        runs.add(added);
    }
    let hours = AllowedHours { from_secs: 8 * HOUR, until_secs: 18 * HOUR, ..AllowedHours::default() };
    let [first, second] = task_weeks(&runs, &Zone::utc(), hours)[..] else { panic!("two weeks") };
    assert_eq!((first.monday, first.runs, first.failed, first.interventions), (MONDAY, 6, 2, 1));
    // The active times are 9 to 12, 17 to 18, and an hour on two other days.
    assert_eq!((first.active_secs / 3_600.0, first.allowed_secs / 3_600.0), (6.0, 70.0));
    assert!((first.autonomy_percent() - 600.0 / 70.0).abs() < 1e-12);
    // The lifetime is from 9 on Monday to 10 on Tuesday.
    assert_eq!(first.lifetime_secs / 3_600.0, 25.0);
    // Of the last week, only the day of the last report counts as allowed.
    assert_eq!((second.active_secs / 3_600.0, second.allowed_secs / 3_600.0), (1.0, 10.0));
    assert_eq!(second.lifetime_secs / 3_600.0, 24.0);
}

#[test]
fn reports_are_bounded_and_ordered() {
    let mut runs = TaskRuns::default();
    for hour in (0..TASK_RUNS_MAX as i64 + 5).rev() {
        runs.add(run("clean", (hour, hour + 1), true));
    }
    let starts: Vec<i64> = runs.oldest_first().map(|run| run.start_nanos).collect();
    assert!(starts.is_sorted());
    // The newest reports are kept, and an older report that arrives is dropped.
    assert_eq!((starts.len(), runs.oldest_first().next()), (TASK_RUNS_MAX, Some(&run("clean", (5, 6), true))));
}

fn step(hours: (i64, i64), work: KeptWork) -> KeptStep {
    let TaskRun { start_nanos, end_nanos, .. } = run("clean", hours, true);
    KeptStep { departure_nanos: start_nanos - HOUR_NANOS / 2, start_nanos, end_nanos, work }
}

fn plan(day: LocalDay) -> KeptPlan {
    let task = KeptWork::Task { name: name("clean", "hall"), value: 2.0, success: 0.9 };
    let explore = KeptWork::Explore { place: "lab".to_owned(), information_bits: 0.5 };
    KeptPlan { day, made_nanos: 7, steps: vec![step((9, 10), task), step((11, 12), explore)] }
}

#[test]
fn a_book_keeps_tasks_and_the_plans_of_days() {
    let mut book = TaskBook::default();
    book.apply(&TaskEdit::Set(task())).unwrap();
    book.apply(&TaskEdit::Set(RobotTask { value: 3.0, ..task() })).unwrap();
    assert_eq!(book.tasks().map(|task| task.value).collect::<Vec<_>>(), [3.0]);
    for day in 0..KEPT_PLANS_MAX as i32 + 1 {
        book.apply(&TaskEdit::KeepPlan(plan(LocalDay(MONDAY.0 + day)))).unwrap();
    }
    assert_eq!((book.plan(MONDAY), book.plans().len()), (None, KEPT_PLANS_MAX));
    let kept = book.plan(LocalDay(MONDAY.0 + 1)).unwrap();
    let at = |hours: f64| {
        let nanos = run("clean", (0, 1), true).start_nanos + (hours * 3.6e12) as i64;
        kept.at(nanos).map(|step| matches!(step.work, KeptWork::Task { .. }))
    };
    assert_eq!([at(8.4), at(8.5), at(9.5), at(10.0), at(11.5)], [None, Some(true), Some(true), None, Some(false)]);
    book.apply(&TaskEdit::Remove(name("clean", "hall"))).unwrap();
    let unknown = book.apply(&TaskEdit::Remove(name("clean", "hall")));
    assert_eq!(unknown, Err(TaskError::Unknown("clean/hall".to_owned())));
}

#[test]
fn a_plan_that_contradicts_itself_is_not_kept() {
    let mut book = TaskBook::default();
    let mut overlapping = plan(MONDAY);
    overlapping.steps[1].departure_nanos = overlapping.steps[0].start_nanos;
    let mut endless = plan(MONDAY);
    endless.steps[0].work = KeptWork::Explore { place: "lab".to_owned(), information_bits: f64::NAN };
    let mut nowhere = plan(MONDAY);
    nowhere.steps[1].work = KeptWork::Explore { place: String::new(), information_bits: 0.0 };
    for wrong in [overlapping, endless, nowhere] {
        let error = book.apply(&TaskEdit::KeepPlan(wrong)).unwrap_err();
        assert!(matches!(error, TaskError::Plan { day: MONDAY, .. }), "{error}");
    }
    assert_eq!(book, TaskBook::default());
}

#[test]
fn a_renamed_node_keeps_its_tasks_plans_and_reports() {
    let mut book = TaskBook::default();
    let valued = RobotTask { value_state: Some(name("clean", "hall").state()), ..task() };
    book.apply(&TaskEdit::Set(valued)).unwrap();
    book.apply(&TaskEdit::KeepPlan(plan(MONDAY))).unwrap();
    book.add_runs(&[run("clean", (1, 2), true)]);
    book.rename_node(&name("clean", "hall").node, &name("clean", "lobby").node);
    let renamed = book.tasks().next().unwrap();
    assert_eq!(
        (&renamed.name, renamed.value_state.as_ref()),
        (&name("clean", "lobby"), Some(&name("clean", "lobby").state()))
    );
    assert!(
        matches!(&book.plan(MONDAY).unwrap().steps[0].work, KeptWork::Task { name, .. } if name.node.as_str() == "lobby")
    );
    assert_eq!(book.runs().oldest_first().next().unwrap().name, name("clean", "lobby"));
}
