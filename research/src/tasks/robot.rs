//! A robot that does the tasks of its days.
//!
//! Robots differ in how they choose the next task and the way to it. A task can be begun until the latest start that
//! its window allows; a robot that set out for a task in time does it even if it arrives later, and the time by which
//! it ends after the window is its lateness. Other tasks are missed.
//!
//! Invariant: all robots with one seed have the same tasks and meet the same world.

use std::collections::VecDeque;

use rand::Rng as _;
use tidemap_map::{
    name::StateName,
    task::{ALL_WEEKDAYS, AllowedHours, KeptStep, KeptWork, TaskRun, TaskRuns, task_weeks},
    topology::{Edge, NodeId},
};
use tidemap_model::{StopSignal, Zone};
use tidemap_plan::{
    day::{DaySlots, SLOT_NANOS},
    route::RouteOptions,
    tasks::{MapDay, Occurrence, occurrences},
};

use super::{
    TasksError, TasksProtocol,
    demand::{WORKING_SECS, local_day, tasks},
};
use crate::routes::{
    DAY_SECS, RobotKind, START_NANOS, WEEK_DAYS,
    building::{Building, draw},
    robot::{RouteRobot, nanos},
};

/// Share of the failed traversals after which the robot is stuck, and for how long until somebody has helped.
const STUCK: f64 = 0.03;
const HELP_SECS: f64 = 900.0;
/// Key of the draws, apart from the draws of the building.
const STUCK_KEY: u64 = u64::MAX - 2;
/// A plan is made anew when the robot is later than planned by more than this.
const BEHIND_SECS: f64 = 60.0;

/// The method by which a robot works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskRobotKind {
    /// First come, first served, on the shortest ways.
    FirstCome,
    /// First come, first served, on the ways that tidemap plans.
    FirstComeRouted,
    /// By tidemap's plan of the day, on the ways that it plans. It plans again when it is behind.
    Planned,
}

impl TaskRobotKind {
    /// All kinds, the baseline first.
    pub const ALL: [TaskRobotKind; 3] =
        [TaskRobotKind::FirstCome, TaskRobotKind::FirstComeRouted, TaskRobotKind::Planned];

    /// The name of the robot in results.
    pub fn name(self) -> &'static str {
        match self {
            TaskRobotKind::FirstCome => "first-come",
            TaskRobotKind::FirstComeRouted => "first-come+routes",
            TaskRobotKind::Planned => "tidemap",
        }
    }

    fn ways(self) -> RobotKind {
        match self {
            TaskRobotKind::FirstCome => RobotKind::Shortest,
            TaskRobotKind::FirstComeRouted | TaskRobotKind::Planned => RobotKind::Tidemap,
        }
    }
}

/// The figures of a robot's week.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TaskFigures {
    /// Failed traversals.
    pub failures: u64,
    /// Tasks that were done, charging included.
    pub done: u64,
    /// Tasks that were not done.
    pub missed: u64,
    /// The time by which tasks ended after their windows, summed, seconds.
    pub late_secs: f64,
    /// The number of times that a person had to help.
    pub interventions: u64,
    /// A % of IEEE RAM 2017: the share of the working hours in which tasks were performed, without charging.
    pub autonomy_percent: f64,
    /// The longest lifetime of the system that was reached in the week, seconds.
    pub lifetime_secs: f64,
}

/// A robot with tasks.
struct TaskRobot<'a> {
    kind: TaskRobotKind,
    seed: u64,
    drive: RouteRobot<'a>,
    runs: TaskRuns,
}

/// Lets a robot work for all weeks of the protocol.
pub(super) fn run(kind: TaskRobotKind, seed: u64, protocol: &TasksProtocol) -> Result<Vec<TaskFigures>, TasksError> {
    let learner = kind.ways().learner()?;
    let building = Building::new(seed, learner.topology().clone());
    let nodes: Vec<StateName> = building.topology().nodes().map(|node| node.name.clone()).collect();
    let drive = RouteRobot::new(kind.ways(), &building, learner)?;
    let mut robot = TaskRobot { kind, seed, drive, runs: TaskRuns::default() };
    let mut weeks = vec![TaskFigures::default(); protocol.weeks];
    for day in 0..protocol.weeks * WEEK_DAYS {
        if day > 0 {
            robot.drive.learn(day)?;
        }
        let tasks = tasks(seed, day, protocol.tasks, &nodes).map_err(TasksError::setting)?;
        let open = occurrences(tasks.iter(), &Zone::utc(), local_day(day));
        robot.drive.now_secs = robot.drive.now_secs.max(day as f64 * DAY_SECS + f64::from(WORKING_SECS.start));
        robot.work(&building, day, open, &mut weeks[day / WEEK_DAYS])?;
    }
    let hours = AllowedHours { from_secs: WORKING_SECS.start, until_secs: WORKING_SECS.end, weekdays: ALL_WEEKDAYS };
    for (week, known) in weeks.iter_mut().zip(task_weeks(&robot.runs, &Zone::utc(), hours)) {
        week.autonomy_percent = known.autonomy_percent();
        week.interventions = known.interventions;
        week.lifetime_secs = known.lifetime_secs;
    }
    Ok(weeks)
}

impl TaskRobot<'_> {
    /// Does the tasks of a day.
    fn work<'t>(
        &mut self,
        building: &Building,
        day: usize,
        mut open: Vec<Occurrence<'t>>,
        week: &mut TaskFigures,
    ) -> Result<(), TasksError> {
        let mut plan: Option<VecDeque<KeptStep>> = None;
        loop {
            let now_secs = self.drive.now_secs;
            let in_time = |task: &Occurrence<'_>| now_secs <= latest_start_secs(task);
            week.missed += open.iter().filter(|task| !in_time(task)).count() as u64;
            open.retain(in_time);
            let next = match self.kind {
                TaskRobotKind::FirstCome | TaskRobotKind::FirstComeRouted => first_come(&open),
                TaskRobotKind::Planned => {
                    let mut steps = match plan.take() {
                        Some(steps) if still_holds(&steps, &open, now_secs) => steps,
                        _ => self.plan(building, day, &open)?,
                    };
                    let next = steps.pop_front().and_then(|step| place_in(&open, &step));
                    plan = Some(steps);
                    next
                }
            };
            let Some((index, departure_secs)) = next else { break };
            let task = open.remove(index);
            self.drive.now_secs = now_secs.max(departure_secs);
            self.perform(building, &task, week)?;
        }
        week.missed += open.len() as u64;
        Ok(())
    }

    /// Drives to the place of a task and does it.
    fn perform(
        &mut self,
        building: &Building,
        task: &Occurrence<'_>,
        week: &mut TaskFigures,
    ) -> Result<(), TasksError> {
        let name = task.task.name.clone();
        let node = building.topology().node_named(name.node.as_str()).map_err(TasksError::setting)?.id;
        let failures = self.go(node, week)?;
        let start_secs = self.drive.now_secs.max(secs(task.from_nanos));
        let end_secs = start_secs + f64::from(task.task.duration_secs);
        self.drive.now_secs = end_secs;
        week.done += 1;
        week.late_secs += (end_secs - secs(task.until_nanos)).max(0.0);
        self.runs.add(TaskRun {
            name,
            start_nanos: nanos(start_secs),
            end_nanos: nanos(end_secs),
            success: true,
            intervention: failures > 0,
            reason: String::new(),
        });
        Ok(())
    }

    /// Drives to a node, and returns how often somebody had to help.
    fn go(&mut self, node: NodeId, week: &mut TaskFigures) -> Result<u64, TasksError> {
        let failures = self.drive.go(node)?;
        week.failures += failures;
        let mut random = draw(self.seed, [STUCK_KEY, u64::from(node.0), self.drive.now_secs as u64]);
        let stuck = (0..failures).filter(|_| random.random_bool(STUCK)).count() as u64;
        self.drive.now_secs += HELP_SECS * stuck as f64;
        Ok(stuck)
    }

    /// The plan of the rest of a day.
    fn plan(&self, building: &Building, day: usize, open: &[Occurrence<'_>]) -> Result<VecDeque<KeptStep>, TasksError> {
        let slots = DaySlots::of(&Zone::utc(), local_day(day), SLOT_NANOS)?;
        let RouteOptions { recovery_secs, failure_cost_secs, .. } = RouteOptions::default();
        let day = MapDay {
            topology: building.topology(),
            slots: &slots,
            occurrences: open,
            start: self.drive.at,
            ready_nanos: nanos(self.drive.now_secs),
            recovery_secs,
            failure_cost_secs,
        };
        let (edges, first_nanos) = (self.drive.edges(), slots.start_nanos(0));
        let mut ahead = |edge: &Edge, at_secs: f64| Some(edges.forecast(edge, first_nanos + (at_secs * 1e9) as i64));
        Ok(day.plan(&mut ahead, |_| None, StopSignal::NEVER)?.steps.into())
    }
}

/// The task whose window opens first, and when to set out: as soon as it is open.
fn first_come(open: &[Occurrence<'_>]) -> Option<(usize, f64)> {
    let first = open.iter().enumerate().min_by_key(|(index, task)| (task.from_nanos, *index));
    first.map(|(index, task)| (index, secs(task.from_nanos)))
}

/// Whether the next step of a plan can be done as planned, or the plan has no further step.
fn still_holds(steps: &VecDeque<KeptStep>, open: &[Occurrence<'_>], now_secs: f64) -> bool {
    let next = steps.front().map(|step| place_in(open, step));
    next.is_none_or(|next| next.is_some_and(|(_, departure_secs)| now_secs <= departure_secs + BEHIND_SECS))
}

/// The task of a planned step, and when to set out.
fn place_in(open: &[Occurrence<'_>], step: &KeptStep) -> Option<(usize, f64)> {
    let KeptWork::Task { name, .. } = &step.work else { return None };
    let is_planned = |task: &Occurrence<'_>| {
        task.task.name == *name && (task.from_nanos..task.until_nanos).contains(&step.start_nanos)
    };
    open.iter().position(is_planned).map(|index| (index, secs(step.departure_nanos)))
}

fn latest_start_secs(task: &Occurrence<'_>) -> f64 {
    secs(task.until_nanos) - f64::from(task.task.duration_secs)
}

/// Seconds since midnight before the first Monday.
fn secs(utc_nanos: i64) -> f64 {
    (utc_nanos - START_NANOS) as f64 / 1e9
}
