//! Robots have the tasks that their days name, and a robot that plans fails less often.

use tidemap_map::{name::StateName, task::CHARGE_KIND};
use tidemap_model::Zone;
use tidemap_plan::tasks::occurrences;

use super::{demand, *};

fn outcome() -> TaskComparison {
    run(&TasksProtocol { seeds: 1, first_seed: 3, weeks: 2, tasks: 10 }, &|_, _| {}).expect("robots")
}

#[test]
fn a_robot_that_plans_fails_less_often_than_one_that_serves_first_come_first() {
    let outcome = outcome();
    let course = |kind: TaskRobotKind| outcome.courses.iter().find(|course| course.kind == kind).expect("a robot");
    let (first, planned) = (course(TaskRobotKind::FirstCome), course(TaskRobotKind::Planned));
    let failures = |course: &TaskCourse| course.weekly(0..2, |week| week.failures as f64).mean;
    assert!(failures(planned) < failures(first), "{planned:?} {first:?}");
    assert!(outcome.of_first_come(planned) < 1.0 && outcome.of_first_come(first) == 1.0);
    // Every task is done or missed: ten a day, and charging four times a day.
    for course in &outcome.courses {
        let weeks = &course.seeds[0];
        assert!(weeks.iter().all(|week| week.done + week.missed == 7 * 14), "{course:?}");
        assert!(weeks.iter().all(|week| week.done > 7 * 12), "{course:?}");
        assert!(weeks.iter().all(|week| (5.0..40.0).contains(&week.autonomy_percent)), "{course:?}");
        assert!(weeks.iter().all(|week| week.lifetime_secs <= 14.0 * 86_400.0), "{course:?}");
    }
}

#[test]
fn the_day_has_its_tasks_and_charging_in_each_part() {
    let nodes = ["lab1", "store"].map(|name| StateName::new(name).expect("a name"));
    let tasks = demand::tasks(1, 8, 30, &nodes).expect("tasks");
    assert_eq!(tasks, demand::tasks(1, 8, 30, &nodes).expect("tasks"));
    assert_ne!(tasks, demand::tasks(1, 9, 30, &nodes).expect("tasks"));
    assert!(tasks.iter().all(|task| task.check().is_ok()), "{tasks:?}");
    let day = occurrences(tasks.iter(), &Zone::utc(), demand::local_day(8));
    let charging = day.iter().filter(|part| part.task.name.kind.as_str() == CHARGE_KIND).count();
    assert_eq!((charging, day.len()), (4, 34));
    assert!(occurrences(tasks.iter(), &Zone::utc(), demand::local_day(9)).is_empty());
}

#[test]
fn figures_are_means_over_weeks_tasks_and_seeds() {
    let week = |failures, done, late_secs| TaskFigures { failures, done, late_secs, ..TaskFigures::default() };
    let course = |kind, seeds| TaskCourse { kind, seeds };
    let first = course(
        TaskRobotKind::FirstCome,
        vec![vec![week(6, 10, 30.0), week(4, 10, 0.0)], vec![week(8, 10, 0.0), week(2, 10, 0.0)]],
    );
    let planned = course(
        TaskRobotKind::Planned,
        vec![vec![week(3, 10, 0.0), week(2, 10, 0.0)], vec![week(4, 10, 0.0), week(2, 10, 0.0)]],
    );
    let outcome = TaskComparison { courses: vec![first, planned], weeks: 2 };
    let [first, planned] = [&outcome.courses[0], &outcome.courses[1]];
    assert_eq!(outcome.of_first_come(planned), 0.55);
    assert_eq!((outcome.seeds_halved(planned), outcome.seeds_halved(first)), (1, 0));
    assert_eq!(first.weekly(0..1, |week| week.failures as f64).mean, 7.0);
    assert_eq!(first.per_task(0..2, |week| week.late_secs).mean, 0.75);
}
