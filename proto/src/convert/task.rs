//! Tasks, plans of tasks, reports of tasks, and their figures.
//!
//! Invariant: a zero or absent field has its default; the map checks the numbers of a task.

use tidemap_map::{
    name::{StateName, TaskName},
    task::{ALL_WEEKDAYS, AllowedHours, KeptPlan, KeptStep, KeptWork, RobotTask, TaskDays, TaskRun, TaskWeek},
    traversal::kept_reason,
};
use tidemap_model::LocalDay;
use tidemap_plan::tasks::{PlannedTasks, UnservedReason, UnservedTask};

use super::{
    InvalidField,
    exploration::date_from_wire,
    time::{instant, instant_from_wire, nanos_from_timestamp, timestamp},
};
use crate::v1;

const DAY_SECS: u32 = 86_400;

both_ways!(
    /// A reason for the wire.
    reason_to_wire, reason_from_wire, UnservedReason, v1::UnservedReason,
    [
        NoWindow = NoWindow,
        Unreachable = Unreachable,
        NoValue = NoValue,
        NoTime = NoTime,
        UnknownNode = UnknownNode,
        UnknownState = UnknownState,
    ]
);

/// The name of a task.
///
/// # Errors
/// The field whose name is not valid.
pub fn task_name_from_wire(at: &str, kind: &str, node: &str) -> Result<TaskName, InvalidField> {
    let name = |field: &str, text: &str| {
        StateName::new(text).map_err(|error| InvalidField::new(format!("{at}{field}"), error))
    };
    Ok(TaskName { kind: name("kind", kind)?, node: name("node", node)? })
}

fn weekdays_from_wire(field: &str, weekdays: u32) -> Result<u8, InvalidField> {
    match u8::try_from(weekdays) {
        Ok(0) => Ok(ALL_WEEKDAYS),
        Ok(days) if days <= ALL_WEEKDAYS => Ok(days),
        _ => Err(InvalidField::new(field, format!("{weekdays} is more than 127, which is all seven days"))),
    }
}

/// A task; its numbers are not checked.
///
/// # Errors
/// The invalid field.
pub fn task_from_wire(task: Option<v1::Task>) -> Result<RobotTask, InvalidField> {
    let wire = task.ok_or_else(|| InvalidField::new("task", "missing: name a kind and a node"))?;
    let state = (!wire.value_state.is_empty()).then(|| StateName::stored_or_label(&wire.value_state));
    let value_state = state.transpose().map_err(|error| InvalidField::new("task.value_state", error))?;
    let days = if wire.date.is_empty() {
        TaskDays::Weekly(weekdays_from_wire("task.weekdays", wire.weekdays)?)
    } else if wire.weekdays == 0 {
        TaskDays::On(date_from_wire("task.date", &wire.date)?)
    } else {
        return Err(InvalidField::new("task.date", "name a date or weekdays, not both"));
    };
    Ok(RobotTask {
        name: task_name_from_wire("task.", &wire.kind, &wire.node)?,
        from_secs: wire.from_secs,
        until_secs: if wire.until_secs == 0 { DAY_SECS } else { wire.until_secs },
        duration_secs: wire.duration_secs,
        days,
        every_secs: (wire.every_secs > 0).then_some(wire.every_secs),
        value: wire.value.unwrap_or(1.0),
        value_state,
    })
}

/// A task for the wire.
#[must_use]
pub fn task_to_wire(task: &RobotTask) -> v1::Task {
    let RobotTask { name, from_secs, until_secs, duration_secs, days, every_secs, value, value_state } = task;
    let (weekdays, date) = match days {
        TaskDays::Weekly(days) => (u32::from(*days), String::new()),
        TaskDays::On(day) => (0, day.to_string()),
    };
    v1::Task {
        kind: name.kind.to_string(),
        node: name.node.to_string(),
        from_secs: *from_secs,
        until_secs: *until_secs,
        duration_secs: *duration_secs,
        weekdays,
        date,
        every_secs: every_secs.unwrap_or(0),
        value: Some(*value),
        value_state: value_state.as_ref().map_or_else(String::new, StateName::to_string),
    }
}

/// The planned tasks for the wire, added to the plan of a day.
pub fn planned_to_wire(planned: &PlannedTasks, reply: &mut v1::PlanDayResponse) {
    let PlannedTasks { steps, unserved, expected_value, is_proven } = planned;
    let step = |step: &KeptStep| {
        let KeptWork::Task { name, value, success } = &step.work else { return None };
        Some(v1::PlannedTask {
            kind: name.kind.to_string(),
            node: name.node.to_string(),
            departure_nanos: step.departure_nanos,
            start_nanos: step.start_nanos,
            end_nanos: step.end_nanos,
            value: *value,
            success: *success,
        })
    };
    let unserved_to_wire = |task: &UnservedTask| v1::UnservedTask {
        kind: task.name.kind.to_string(),
        node: task.name.node.to_string(),
        from_nanos: task.from_nanos,
        until_nanos: task.until_nanos,
        reason: reason_to_wire(task.reason).into(),
    };
    reply.tasks = steps.iter().filter_map(step).collect();
    reply.unserved = unserved.iter().map(unserved_to_wire).collect();
    (reply.expected_value, reply.proven) = (*expected_value, *is_proven);
}

/// The planned tasks of a reply.
///
/// # Errors
/// A name that is not valid.
pub fn planned_from_wire(reply: &v1::PlanDayResponse) -> Result<PlannedTasks, InvalidField> {
    let step = |task: &v1::PlannedTask| {
        let name = task_name_from_wire("tasks.", &task.kind, &task.node)?;
        let v1::PlannedTask { departure_nanos, start_nanos, end_nanos, value, success, .. } = *task;
        let work = KeptWork::Task { name, value, success };
        Ok(KeptStep { departure_nanos, start_nanos, end_nanos, work })
    };
    let unserved = |task: &v1::UnservedTask| {
        Ok(UnservedTask {
            name: task_name_from_wire("unserved.", &task.kind, &task.node)?,
            from_nanos: task.from_nanos,
            until_nanos: task.until_nanos,
            reason: reason_from_wire(task.reason()).unwrap_or(UnservedReason::NoTime),
        })
    };
    Ok(PlannedTasks {
        steps: reply.tasks.iter().map(step).collect::<Result<_, _>>()?,
        unserved: reply.unserved.iter().map(unserved).collect::<Result<_, _>>()?,
        expected_value: reply.expected_value,
        is_proven: reply.proven,
    })
}

/// A kept plan for the wire. `now_nanos`: the moment of which the current step is named.
#[must_use]
pub fn plan_to_wire(plan: &KeptPlan, now_nanos: i64) -> v1::GetPlanResponse {
    let step = |step: &KeptStep| {
        let wire = v1::KeptStep {
            departure_nanos: step.departure_nanos,
            start_nanos: step.start_nanos,
            end_nanos: step.end_nanos,
            ..v1::KeptStep::default()
        };
        match &step.work {
            KeptWork::Task { name, value, success } => v1::KeptStep {
                kind: name.kind.to_string(),
                node: name.node.to_string(),
                value: *value,
                success: *success,
                ..wire
            },
            KeptWork::Explore { place, information_bits } => {
                v1::KeptStep { location: place.clone(), information_bits: *information_bits, ..wire }
            }
        }
    };
    let current = plan.at(now_nanos).and_then(|now| plan.steps.iter().position(|step| step == now));
    v1::GetPlanResponse {
        date: plan.day.to_string(),
        made_time: Some(timestamp(plan.made_nanos)),
        steps: plan.steps.iter().map(step).collect(),
        current: current.and_then(|index| u32::try_from(index).ok()),
    }
}

/// A kept plan of a reply, and the index of the current step.
///
/// # Errors
/// A date or a name that is not valid.
pub fn plan_from_wire(reply: &v1::GetPlanResponse) -> Result<(KeptPlan, Option<usize>), InvalidField> {
    let step = |step: &v1::KeptStep| {
        let v1::KeptStep { departure_nanos, start_nanos, end_nanos, value, success, information_bits, .. } = *step;
        let work = if step.kind.is_empty() {
            KeptWork::Explore { place: step.location.clone(), information_bits }
        } else {
            KeptWork::Task { name: task_name_from_wire("steps.", &step.kind, &step.node)?, value, success }
        };
        Ok(KeptStep { departure_nanos, start_nanos, end_nanos, work })
    };
    let plan = KeptPlan {
        day: date_from_wire("date", &reply.date)?,
        made_nanos: instant(reply.made_time).unwrap_or_default(),
        steps: reply.steps.iter().map(step).collect::<Result<_, _>>()?,
    };
    Ok((plan, reply.current.map(|index| index as usize)))
}

/// The question for a kept plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanQuestion {
    /// The day; `None`: that of the time.
    pub day: Option<LocalDay>,
    /// The moment whose current step is requested, nanoseconds UTC; `None`: now.
    pub time_nanos: Option<i64>,
}

/// The question for a kept plan.
///
/// # Errors
/// The invalid field.
pub fn plan_question_from_wire(request: &v1::GetPlanRequest) -> Result<PlanQuestion, InvalidField> {
    let day = (!request.date.is_empty()).then(|| date_from_wire("date", &request.date)).transpose()?;
    let time_nanos = request.time.map(|time| nanos_from_timestamp("time", time)).transpose()?;
    Ok(PlanQuestion { day, time_nanos })
}

/// A report of a task. `now_nanos`: its end if the request has none.
///
/// # Errors
/// The invalid field.
pub fn run_from_wire(request: &v1::ReportTaskRequest, now_nanos: i64) -> Result<TaskRun, InvalidField> {
    let run = TaskRun {
        name: task_name_from_wire("", &request.kind, &request.node)?,
        start_nanos: instant_from_wire("start_time", request.start_time)?,
        end_nanos: request.end_time.map_or(Ok(now_nanos), |time| nanos_from_timestamp("end_time", time))?,
        success: request.success,
        intervention: request.intervention,
        reason: kept_reason(&request.reason),
    };
    run.check().map_err(|error| InvalidField::new("end_time", error))?;
    Ok(run)
}

/// The hours in which a robot may work by itself.
///
/// # Errors
/// They are empty, longer than a day, or on days that do not exist.
pub fn hours_from_wire(request: &v1::ListTaskWeeksRequest) -> Result<AllowedHours, InvalidField> {
    let until_secs = if request.until_secs == 0 { DAY_SECS } else { request.until_secs };
    if request.from_secs >= until_secs || until_secs > DAY_SECS {
        let text = format!("{until_secs} s is not after from_secs ({} s) and within the day", request.from_secs);
        return Err(InvalidField::new("until_secs", text));
    }
    let weekdays = weekdays_from_wire("weekdays", request.weekdays)?;
    Ok(AllowedHours { from_secs: request.from_secs, until_secs, weekdays })
}

/// The figures of a week for the wire.
#[must_use]
pub fn week_to_wire(week: &TaskWeek) -> v1::TaskWeek {
    let TaskWeek { monday, runs, failed, interventions, active_secs, allowed_secs, lifetime_secs } = *week;
    v1::TaskWeek {
        monday: monday.to_string(),
        runs,
        failed,
        interventions,
        active_secs,
        allowed_secs,
        autonomy_percent: week.autonomy_percent(),
        lifetime_secs,
    }
}

/// The figures of a week.
///
/// # Errors
/// A date that is not valid.
pub fn week_from_wire(week: &v1::TaskWeek) -> Result<TaskWeek, InvalidField> {
    let v1::TaskWeek { runs, failed, interventions, active_secs, allowed_secs, lifetime_secs, .. } = *week;
    let monday = date_from_wire("weeks.monday", &week.monday)?;
    Ok(TaskWeek { monday, runs, failed, interventions, active_secs, allowed_secs, lifetime_secs })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire() -> v1::Task {
        v1::Task {
            kind: "clean".to_owned(),
            node: "hall".to_owned(),
            from_secs: 3_600,
            until_secs: 7_200,
            duration_secs: 600,
            weekdays: 31,
            every_secs: 1_800,
            value: Some(2.5),
            value_state: "activity/sleep".to_owned(),
            ..v1::Task::default()
        }
    }

    #[test]
    fn a_task_comes_back() {
        let once = v1::Task { weekdays: 0, date: "2016-03-21".to_owned(), every_secs: 0, ..wire() };
        for wire in [wire(), once] {
            assert_eq!(task_to_wire(&task_from_wire(Some(wire.clone())).expect("right")), wire);
        }
        let plain = v1::Task { weekdays: 0, until_secs: 0, value: None, value_state: String::new(), ..wire() };
        let plain = task_from_wire(Some(plain)).expect("right");
        assert_eq!((plain.days, plain.until_secs), (TaskDays::Weekly(127), 86_400));
        assert_eq!((plain.value, plain.value_state), (1.0, None));
    }

    #[test]
    fn invalid_fields_are_named() {
        let field = |task| task_from_wire(task).expect_err("wrong").field;
        assert_eq!(field(None), "task");
        assert_eq!(field(Some(v1::Task { kind: "a/b".to_owned(), ..wire() })), "task.kind");
        assert_eq!(field(Some(v1::Task { node: String::new(), ..wire() })), "task.node");
        assert_eq!(field(Some(v1::Task { weekdays: 128, ..wire() })), "task.weekdays");
        assert_eq!(field(Some(v1::Task { date: "2016-03-21".to_owned(), ..wire() })), "task.date");
        assert_eq!(field(Some(v1::Task { value_state: "a/b/c/d".to_owned(), ..wire() })), "task.value_state");
        let hours = v1::ListTaskWeeksRequest { from_secs: 9, until_secs: 9, ..Default::default() };
        assert_eq!(hours_from_wire(&hours).expect_err("wrong").field, "until_secs");
        let early = v1::ReportTaskRequest {
            kind: "clean".to_owned(),
            node: "hall".to_owned(),
            start_time: Some(timestamp(9)),
            end_time: Some(timestamp(8)),
            ..Default::default()
        };
        assert_eq!(run_from_wire(&early, 0).expect_err("wrong").field, "end_time");
    }

    #[test]
    fn plans_and_weeks_come_back() {
        let name = TaskName::new("clean", "hall").expect("valid");
        let step = |departure_nanos, work| KeptStep { departure_nanos, start_nanos: 20, end_nanos: 30, work };
        let task = step(10, KeptWork::Task { name: name.clone(), value: 2.0, success: 0.5 });
        let explore = KeptWork::Explore { place: "lab".to_owned(), information_bits: 0.5 };
        let later = KeptStep { departure_nanos: 40, start_nanos: 40, end_nanos: 50, work: explore };
        let plan = KeptPlan { day: LocalDay(17_000), made_nanos: 5, steps: vec![task.clone(), later] };
        assert_eq!(plan_from_wire(&plan_to_wire(&plan, 45)), Ok((plan.clone(), Some(1))));
        assert_eq!(plan_from_wire(&plan_to_wire(&plan, 35)), Ok((plan, None)));

        let reason = UnservedReason::UnknownNode;
        let planned = PlannedTasks {
            steps: vec![task],
            unserved: vec![UnservedTask { name, from_nanos: 3, until_nanos: 4, reason }],
            expected_value: 1.0,
            is_proven: true,
        };
        let mut reply = v1::PlanDayResponse::default();
        planned_to_wire(&planned, &mut reply);
        assert_eq!(planned_from_wire(&reply), Ok(planned));

        let week = TaskWeek {
            monday: LocalDay(16_881),
            runs: 3,
            failed: 2,
            interventions: 1,
            active_secs: 36.0,
            allowed_secs: 360.0,
            lifetime_secs: 7.0,
        };
        let wire = week_to_wire(&week);
        assert_eq!(wire.autonomy_percent, 10.0);
        assert_eq!(week_from_wire(&wire), Ok(week));
    }
}
