//! The tasks of a map on a local day: converts tasks, nodes and moments to the numbers of a plan, and back.
//!
//! Invariant: each occurrence of a task is either a step of the plan or unserved, with a reason. The order of the steps
//! is valid for a kept plan.

use tidemap_map::{
    name::{StateName, TaskName},
    task::{CHARGE_KIND, KeptStep, KeptWork, RobotTask, local_nanos},
    topology::{NodeId, Topology},
};
use tidemap_model::{LocalDay, StopSignal, Zone};

use super::{
    DayTask, LegOptions, LegTable, PLANNED_TASKS_MAX, TaskDay, TaskPlanError, TaskValue, UnservedReason, plan_tasks,
};
use crate::{day::DaySlots, route::Forecasts};

/// A task in one of its windows.
#[derive(Clone, Debug, PartialEq)]
pub struct Occurrence<'a> {
    /// The task.
    pub task: &'a RobotTask,
    /// The earliest start, nanoseconds UTC.
    pub from_nanos: i64,
    /// The latest end, nanoseconds UTC.
    pub until_nanos: i64,
}

/// The occurrences of tasks on a day, in the order of the tasks and then of time.
pub fn occurrences<'a>(tasks: impl Iterator<Item = &'a RobotTask>, zone: &Zone, day: LocalDay) -> Vec<Occurrence<'a>> {
    let of_task = |task: &'a RobotTask| {
        let windows = task.windows(day).into_iter();
        windows.map(move |(from, until)| Occurrence {
            task,
            from_nanos: local_nanos(zone, day, from),
            until_nanos: local_nanos(zone, day, until),
        })
    };
    tasks.flat_map(of_task).collect()
}

/// A day of tasks on a map.
#[derive(Clone, Debug)]
pub struct MapDay<'a> {
    /// The map.
    pub topology: &'a Topology,
    /// The slots in which forecasts and values are constant.
    pub slots: &'a DaySlots,
    /// The occurrences of tasks to plan.
    pub occurrences: &'a [Occurrence<'a>],
    /// The node where the robot is at the beginning.
    pub start: NodeId,
    /// Time at which the robot is ready, nanoseconds UTC.
    pub ready_nanos: i64,
    /// The additional time of a failed attempt at an edge, seconds.
    pub recovery_secs: f64,
    /// The cost of a failure beyond its time, seconds. It affects the choice of ways.
    pub failure_cost_secs: f64,
}

/// A task that is not planned.
#[derive(Clone, Debug, PartialEq)]
pub struct UnservedTask {
    /// Name of the task.
    pub name: TaskName,
    /// The earliest start, nanoseconds UTC.
    pub from_nanos: i64,
    /// The latest end, nanoseconds UTC.
    pub until_nanos: i64,
    /// The reason why the task is not planned.
    pub reason: UnservedReason,
}

/// The planned tasks of a day.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlannedTasks {
    /// The tasks in their order.
    pub steps: Vec<KeptStep>,
    /// Tasks that are not planned, in the order of the occurrences.
    pub unserved: Vec<UnservedTask>,
    /// Sum of the values, each times the success of the way to it unless the task charges the robot.
    pub expected_value: f64,
    /// Whether no plan is better.
    pub is_proven: bool,
}

impl MapDay<'_> {
    fn secs(&self, utc_nanos: i64) -> f64 {
        utc_nanos.saturating_sub(self.slots.start_nanos(0)) as f64 / 1e9
    }

    fn nanos(&self, secs: f64) -> i64 {
        self.slots.start_nanos(0).saturating_add((secs * 1e9).round() as i64)
    }

    /// Plans the day. `forecasts` are in seconds after the first slot's start. `chances`: the probability of a state in
    /// each slot; `None` where there is no such state.
    ///
    /// # Errors
    /// [`TaskPlanError`].
    pub fn plan(
        &self,
        forecasts: &mut impl Forecasts,
        chances: impl Fn(&StateName) -> Option<Vec<f64>>,
        stop: StopSignal<'_>,
    ) -> Result<PlannedTasks, TaskPlanError> {
        let found = self.occurrences.len();
        if found > PLANNED_TASKS_MAX {
            return Err(TaskPlanError::TooMany { found });
        }
        let mut nodes = vec![self.start];
        let mut planned: Vec<(usize, DayTask)> = Vec::new();
        let mut reasons = vec![None; found];
        for (index, Occurrence { task, from_nanos, until_nanos }) in self.occurrences.iter().enumerate() {
            let Ok(node) = self.topology.node_named(task.name.node.as_str()) else {
                reasons[index] = Some(UnservedReason::UnknownNode);
                continue;
            };
            let value = match &task.value_state {
                None => TaskValue::Fixed(task.value),
                Some(state) => match chances(state) {
                    Some(chances) => TaskValue::BySlot(chances.iter().map(|chance| chance * task.value).collect()),
                    None => {
                        reasons[index] = Some(UnservedReason::UnknownState);
                        continue;
                    }
                },
            };
            let place = nodes.iter().position(|known| *known == node.id).unwrap_or(nodes.len());
            if place == nodes.len() {
                nodes.push(node.id);
            }
            let (from_secs, until_secs) = (self.secs(*from_nanos), self.secs(*until_nanos));
            let duration_secs = f64::from(task.duration_secs);
            let persists = task.name.kind.as_str() == CHARGE_KIND;
            planned.push((index, DayTask { place, from_secs, until_secs, duration_secs, value, persists }));
        }
        let legs = LegTable::between(self.topology, &nodes, &self.leg_options(), forecasts, stop)?;
        let tasks: Vec<DayTask> = planned.iter().map(|(_, task)| task.clone()).collect();
        let day = TaskDay { tasks: &tasks, legs: &legs, start: 0, ready_secs: self.secs(self.ready_nanos) };
        let plan = plan_tasks(&day, stop)?;
        for (task, reason) in plan.unserved {
            reasons[planned[task].0] = Some(reason);
        }
        let step = |step: &super::TaskStep| KeptStep {
            departure_nanos: self.nanos(step.departure_secs),
            start_nanos: self.nanos(step.start_secs),
            end_nanos: self.nanos(step.end_secs),
            work: KeptWork::Task {
                name: self.occurrences[planned[step.task].0].task.name.clone(),
                value: step.value,
                success: step.success,
            },
        };
        let unserved = |(Occurrence { task, from_nanos, until_nanos }, reason): (&Occurrence<'_>, Option<_>)| {
            let (name, from_nanos, until_nanos) = (task.name.clone(), *from_nanos, *until_nanos);
            reason.map(|reason| UnservedTask { name, from_nanos, until_nanos, reason })
        };
        Ok(PlannedTasks {
            steps: plan.steps.iter().map(step).collect(),
            unserved: self.occurrences.iter().zip(reasons).filter_map(unserved).collect(),
            expected_value: plan.expected_value,
            is_proven: plan.is_proven,
        })
    }

    fn leg_options(&self) -> LegOptions {
        LegOptions {
            slot_secs: self.secs(self.slots.start_nanos(1)),
            slots: self.slots.count(),
            recovery_secs: self.recovery_secs,
            failure_cost_secs: self.failure_cost_secs,
        }
    }
}

#[cfg(test)]
mod tests {
    use tidemap_map::task::TaskDays;
    use tidemap_map::topology::Edge;

    use super::*;
    use crate::{day::SLOT_NANOS, route::EdgeForecast, testkit::street};

    #[test]
    fn tasks_of_a_map_become_steps_and_reasons() {
        let (zone, day) = (Zone::named("Europe/London").unwrap(), LocalDay(16_881));
        let slots = DaySlots::of(&zone, day, SLOT_NANOS).unwrap();
        let topology = street(4);
        let task = |kind: &str, node: &str| RobotTask {
            name: TaskName::new(kind, node).unwrap(),
            from_secs: 9 * 3_600,
            until_secs: 11 * 3_600,
            duration_secs: 600,
            days: TaskDays::Weekly(1),
            every_secs: None,
            value: 2.0,
            value_state: None,
        };
        let people = RobotTask { value_state: Some(StateName::new("people").unwrap()), ..task("greet", "n2") };
        let nobody = RobotTask { value_state: Some(StateName::new("nobody").unwrap()), ..task("wait", "n2") };
        let twice = RobotTask { every_secs: Some(3_600), ..task("clean", "n3") };
        let sunday = RobotTask { days: TaskDays::Weekly(64), ..task("rest", "n1") };
        let tasks = [people, nobody, twice, task("lost", "n9"), sunday];
        let occurrences = occurrences(tasks.iter(), &zone, day);
        assert_eq!(occurrences.len(), 5);
        let map = MapDay {
            topology: &topology,
            slots: &slots,
            occurrences: &occurrences,
            start: NodeId(0),
            ready_nanos: slots.start_nanos(0),
            recovery_secs: 60.0,
            failure_cost_secs: 600.0,
        };
        let mut ahead = |_: &Edge, _: f64| Some(EdgeForecast { success: 0.5, duration_secs: 10.0, evidence: 9.0 });
        // People come from 10 o'clock on.
        let chances = |state: &StateName| {
            (state.as_str() == "people").then(|| (0..96).map(|slot| if slot < 40 { 0.1 } else { 0.9 }).collect())
        };
        let plan = map.plan(&mut ahead, chances, StopSignal::NEVER).unwrap();
        let at = |step: &KeptStep| (step.start_nanos - slots.start_nanos(0)) / 1_000_000_000;
        let shown: Vec<_> = plan.steps.iter().map(|step| (at(step), &step.work)).collect();
        let name = |work: &KeptWork| match work {
            KeptWork::Task { name, value, success } => (name.to_string(), *value, *success),
            KeptWork::Explore { .. } => panic!("{work:?}"),
        };
        assert_eq!(shown.len(), 3, "{shown:?}");
        assert_eq!((shown[0].0, name(shown[0].1)), (9 * 3_600, ("clean/n3".to_owned(), 2.0, 0.13)));
        assert!(shown.iter().any(|(at, work)| *at >= 10 * 3_600 && name(work) == ("greet/n2".to_owned(), 1.8, 0.5)));
        let reasons: Vec<_> = plan.unserved.iter().map(|task| (task.name.kind.as_str(), task.reason)).collect();
        assert_eq!(reasons, [("wait", UnservedReason::UnknownState), ("lost", UnservedReason::UnknownNode)]);
        // The robot does not leave hours before: three edges take 240 s, possible failures included.
        assert_eq!(plan.steps[0].start_nanos - plan.steps[0].departure_nanos, 240_000_000_000);
    }
}
