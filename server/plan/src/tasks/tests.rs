//! Checks plans of tasks against plain enumeration over whole seconds, and the results for single tasks.

use std::collections::HashMap;

use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_map::topology::{Edge, NodeId};

use super::*;
use crate::{route::EdgeForecast, testkit::street};

const SLOT: usize = 6;
const SLOTS: usize = 4;

/// A world in whole seconds.
#[derive(Debug)]
struct World {
    tasks: Vec<DayTask>,
    legs: LegTable,
}

impl World {
    fn random(count: usize, seed: u64) -> World {
        let mut random = SmallRng::seed_from_u64(seed);
        let places = random.random_range(1..=count + 1);
        let dense: bool = random.random();
        let legs = LegTable::new((SLOT as f64, SLOTS), places, |_, _, _| {
            let is_open = random.random_range(0..8) > 0;
            let secs = f64::from(random.random_range(0..if dense { 3_u8 } else { 9 }));
            is_open.then(|| Leg { secs, success: f64::from(random.random_range(1..=4_u8)) / 4.0 })
        });
        let day = (SLOT * SLOTS) as u32;
        let mut task = || {
            let from = random.random_range(0..day - 4);
            let until = random.random_range(from + 2..=day + 3);
            let value = if random.random() {
                TaskValue::Fixed(f64::from(random.random_range(0..9_u8)))
            } else {
                TaskValue::BySlot((0..SLOTS).map(|_| f64::from(random.random_range(0..9_u8))).collect())
            };
            DayTask {
                place: random.random_range(0..places),
                from_secs: f64::from(from),
                until_secs: f64::from(until),
                duration_secs: f64::from(random.random_range(1..if dense { 4_u8 } else { 8 })),
                value,
                persists: random.random_range(0..4) == 0,
            }
        };
        World { tasks: (0..count).map(|_| task()).collect(), legs: legs.unwrap() }
    }

    fn day(&self) -> TaskDay<'_> {
        TaskDay { tasks: &self.tasks, legs: &self.legs, start: 0, ready_secs: 1.0 }
    }

    /// The greatest value from a moment on: every remaining task begins at every possible second, or the robot waits a
    /// second.
    fn best(&self, known: &mut HashMap<(usize, usize, usize), f64>, (done, place, at): (usize, usize, usize)) -> f64 {
        if at > SLOT * SLOTS + 3 {
            return 0.0;
        }
        if let Some(&value) = known.get(&(done, place, at)) {
            return value;
        }
        let slot = |at: usize| (at / SLOT).min(SLOTS - 1);
        let mut best = self.best(known, (done, place, at + 1));
        for (index, task) in self.tasks.iter().enumerate().filter(|(index, _)| done & (1 << index) == 0) {
            let Some(leg) = self.legs.at(place, task.place, slot(at)) else { continue };
            let arrival = at + leg.secs as usize;
            let last = task.until_secs as usize - task.duration_secs.min(task.until_secs) as usize;
            let is_short = task.from_secs + task.duration_secs > task.until_secs;
            for start in arrival.max(task.from_secs as usize)..=last {
                // A task without value is not done, not even to change the place.
                if is_short || task.value.at(slot(start)) == 0.0 {
                    continue;
                }
                let end = start + task.duration_secs as usize;
                let after = self.best(known, (done | (1 << index), task.place, end));
                best = best.max(task.worth(task.value.at(slot(start)), leg.success) + after);
            }
        }
        known.insert((done, place, at), best);
        best
    }
}

/// Checks that a plan is possible, and that its numbers are those of the world.
fn check_plan(world: &World, plan: &TaskPlan) {
    let (mut place, mut ready) = (0, 1.0);
    for step in &plan.steps {
        let task = &world.tasks[step.task];
        assert!(step.departure_secs >= ready, "{step:?} after {ready}");
        let leg = world.legs.at(place, task.place, world.legs.slot_of(step.departure_secs)).unwrap();
        assert!(step.start_secs >= step.departure_secs + leg.secs, "{step:?} {leg:?}");
        assert_eq!(step.success, leg.success);
        assert_eq!(step.value, task.value.at(world.legs.slot_of(step.start_secs)));
        assert!(step.start_secs >= task.from_secs && step.end_secs <= task.until_secs, "{step:?} {task:?}");
        assert_eq!(step.end_secs, step.start_secs + task.duration_secs);
        (place, ready) = (task.place, step.end_secs);
    }
    let mut all: Vec<usize> = plan.steps.iter().map(|step| step.task).collect();
    all.extend(plan.unserved.iter().map(|(task, _)| *task));
    all.sort_unstable();
    assert_eq!(all, (0..world.tasks.len()).collect::<Vec<_>>(), "each task once");
}

#[test]
fn a_plan_is_worth_what_the_enumeration_finds() {
    let mut served = 0;
    for seed in 0..1_000 {
        let count = if seed % 50 == 0 { 8 } else { 1 + seed as usize % 5 };
        let world = World::random(count, seed);
        let plan = plan_tasks(&world.day(), StopSignal::NEVER).unwrap();
        check_plan(&world, &plan);
        let best = world.best(&mut HashMap::new(), (0, 0, 1));
        assert!((plan.expected_value - best).abs() < 1e-9, "seed {seed}: {plan:?}, and {best} is possible");
        assert!(plan.is_proven);
        assert_eq!(plan, plan_tasks(&world.day(), StopSignal::NEVER).unwrap());
        served += plan.steps.len();
    }
    assert!(served > 1_000, "the worlds have something to plan: {served}");
}

#[test]
fn insertion_and_moves_come_near_the_best() {
    let (mut found, mut best) = (0.0, 0.0);
    for seed in 0..40 {
        let world = World::random(9, 7_000 + seed);
        let day = world.day();
        let mut timing = Timing::new(&day);
        let all: Vec<usize> = (0..world.tasks.len()).collect();
        found += search_order(&mut timing, &all, StopSignal::NEVER).unwrap().unwrap().value;
        best += plan_tasks(&day, StopSignal::NEVER).unwrap().expected_value;
    }
    assert!(found <= best + 1e-9 && found > 0.95 * best, "{found} of {best}");
}

#[test]
fn many_tasks_are_planned_without_overlap() {
    let world = World::random(40, 3);
    let plan = plan_tasks(&world.day(), StopSignal::NEVER).unwrap();
    check_plan(&world, &plan);
    assert!(!plan.is_proven && plan.steps.len() > 3, "{plan:?}");
    let stopped = plan_tasks(&world.day(), StopSignal::new(&|| true));
    assert_eq!(stopped, Err(TaskPlanError::Stopped));
}

fn task(place: usize, window: (f64, f64), value: f64) -> DayTask {
    let (from_secs, until_secs) = window;
    DayTask { place, from_secs, until_secs, duration_secs: 60.0, value: TaskValue::Fixed(value), persists: false }
}

#[test]
fn what_is_left_out_has_its_reason() {
    let legs =
        LegTable::new((900.0, 4), 3, |_, from, to| (from != 2 && to != 2).then_some(Leg { secs: 100.0, success: 0.9 }));
    let tasks = [
        task(0, (0.0, 60.0), 5.0),
        task(0, (0.0, 70.0), 1.0),
        task(1, (0.0, 59.0), 1.0),
        task(2, (0.0, 900.0), 1.0),
        task(1, (0.0, 900.0), 0.0),
        task(1, (0.0, 150.0), 1.0),
    ];
    let day = TaskDay { tasks: &tasks, legs: &legs.unwrap(), start: 0, ready_secs: 0.0 };
    let plan = plan_tasks(&day, StopSignal::NEVER).unwrap();
    assert_eq!(plan.steps.iter().map(|step| step.task).collect::<Vec<_>>(), [0]);
    let reasons = [
        (1, UnservedReason::NoTime),
        (2, UnservedReason::NoWindow),
        (3, UnservedReason::Unreachable),
        (4, UnservedReason::NoValue),
        (5, UnservedReason::NoWindow),
    ];
    assert_eq!(plan.unserved, reasons);
}

#[test]
fn the_robot_waits_for_the_hour_that_is_worth_more() {
    let legs = LegTable::new((900.0, 4), 2, |slot, _, _| Some(Leg { secs: 30.0, success: [0.2, 0.2, 0.9, 0.8][slot] }));
    let tasks = [DayTask {
        place: 1,
        from_secs: 0.0,
        until_secs: 3_600.0,
        duration_secs: 300.0,
        value: TaskValue::BySlot(vec![1.0, 1.0, 1.0, 1.1]),
        persists: false,
    }];
    let day = TaskDay { tasks: &tasks, legs: &legs.unwrap(), start: 0, ready_secs: 0.0 };
    let plan = plan_tasks(&day, StopSignal::NEVER).unwrap();
    // The robot departs as late as the best way allows, and waits at the place until the value is greatest.
    let TaskStep { departure_secs, start_secs, end_secs, .. } = plan.steps[0];
    assert_eq!((departure_secs, start_secs, end_secs), (2_670.0, 2_700.0, 3_000.0));
    assert!((plan.expected_value - 0.99).abs() < 1e-12);
}

#[test]
fn legs_are_the_cheapest_ways_of_their_slots() {
    let topology = street(4);
    let shut = |edge: &Edge, at_secs: f64| edge.from == NodeId(2) && edge.to == NodeId(3) && at_secs > 900.0;
    let mut ahead = |edge: &Edge, at_secs: f64| {
        (!shut(edge, at_secs)).then_some(EdgeForecast { success: 0.5, duration_secs: 10.0, evidence: 9.0 })
    };
    let options = LegOptions { slot_secs: 900.0, slots: 2, recovery_secs: 20.0, failure_cost_secs: 600.0 };
    let nodes = [NodeId(0), NodeId(3), NodeId(0)];
    let legs = LegTable::between(&topology, &nodes, &options, &mut ahead, StopSignal::NEVER).unwrap();
    // Each edge fails once on average: 10 s, and before that 10 s and the recovery.
    assert_eq!(legs.at(0, 1, 0), Some(Leg { secs: 120.0, success: 0.13 }));
    assert_eq!(legs.at(0, 1, 1), None);
    assert_eq!(legs.at(1, 0, 1), Some(Leg { secs: 120.0, success: 0.13 }));
    assert_eq!(legs.at(0, 2, 1), Some(Leg { secs: 0.0, success: 1.0 }));
    let unknown = LegTable::between(&topology, &[NodeId(9)], &options, &mut ahead, StopSignal::NEVER);
    assert_eq!(unknown, Err(LegError::UnknownNode(9)));
}

#[test]
fn invalid_tasks_are_named() {
    let legs = LegTable::new((900.0, 1), 1, |_, _, _| None).unwrap();
    let wrong = |task: DayTask| {
        let tasks = [task];
        plan_tasks(&TaskDay { tasks: &tasks, legs: &legs, start: 0, ready_secs: 0.0 }, StopSignal::NEVER).unwrap_err()
    };
    assert_eq!(wrong(task(4, (0.0, 90.0), 1.0)), TaskPlanError::UnknownPlace(4));
    for (task, words) in [
        (task(0, (0.0, 90.0), -1.0), "the value of task 0 is -1"),
        (DayTask { duration_secs: 0.0, ..task(0, (0.0, 90.0), 1.0) }, "the duration of task 0 is 0"),
        (task(0, (0.0, f64::INFINITY), 1.0), "the latest end of task 0"),
    ] {
        let text = wrong(task).to_string();
        assert!(text.contains(words), "{text}");
    }
}
