//! Tasks, kept plans and reports of tasks on the disk: one row.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_layout::task as layout;
use tidemap_map::{
    name::{StateName, TaskName},
    site::{Site, SiteEdit},
    task::{KeptPlan, KeptStep, KeptWork, RobotTask, TaskBook, TaskDays, TaskEdit, TaskRun, TaskRuns},
    traversal::kept_reason,
};
use tidemap_model::LocalDay;

use super::StoredTable;
use crate::record::Invalid;

fn decode_name(kind: &str, node: &str) -> Result<TaskName, Invalid> {
    TaskName::new(kind, node).map_err(|_| "the name of a task is not valid")
}

fn encode_task(task: &RobotTask) -> layout::Task {
    let RobotTask { name, from_secs, until_secs, duration_secs, days, every_secs, value, value_state } = task;
    let (weekdays, day) = match *days {
        TaskDays::Weekly(days) => (u32::from(days), None),
        TaskDays::On(day) => (0, Some(day.0)),
    };
    layout::Task {
        kind: name.kind.as_str().to_owned(),
        node: name.node.as_str().to_owned(),
        from_secs: *from_secs,
        until_secs: *until_secs,
        duration_secs: *duration_secs,
        weekdays,
        day,
        every_secs: *every_secs,
        value_bits: value.to_bits(),
        value_state: value_state.as_ref().map_or_else(String::new, |state| state.as_str().to_owned()),
    }
}

fn decode_task(message: &layout::Task) -> Result<RobotTask, Invalid> {
    let layout::Task { kind, node, from_secs, until_secs, duration_secs, weekdays, day, every_secs, .. } = message;
    let days = match (day, u8::try_from(*weekdays)) {
        (Some(day), _) => TaskDays::On(LocalDay(*day)),
        (None, Ok(days)) => TaskDays::Weekly(days),
        (None, Err(_)) => return Err("the days of a task are not valid"),
    };
    let state = StateName::stored_or_label(&message.value_state);
    let value_state = match message.value_state.is_empty() {
        true => None,
        false => Some(state.map_err(|_| "the state of a task's value has an invalid name")?),
    };
    Ok(RobotTask {
        name: decode_name(kind, node)?,
        from_secs: *from_secs,
        until_secs: *until_secs,
        duration_secs: *duration_secs,
        days,
        every_secs: *every_secs,
        value: f64::from_bits(message.value_bits),
        value_state,
    })
}

fn encode_step(step: &KeptStep) -> layout::PlanStep {
    let (kind, place, worth, success) = match &step.work {
        KeptWork::Task { name, value, success } => (name.kind.as_str(), name.node.as_str(), *value, *success),
        KeptWork::Explore { place, information_bits } => ("", place.as_str(), *information_bits, 0.0),
    };
    layout::PlanStep {
        departure_nanos: step.departure_nanos,
        travel_nanos: step.start_nanos.wrapping_sub(step.departure_nanos),
        duration_nanos: step.end_nanos.wrapping_sub(step.start_nanos),
        kind: kind.to_owned(),
        place: place.to_owned(),
        worth_bits: worth.to_bits(),
        success_bits: success.to_bits(),
    }
}

fn decode_step(message: &layout::PlanStep) -> Result<KeptStep, Invalid> {
    let (worth, success) = (f64::from_bits(message.worth_bits), f64::from_bits(message.success_bits));
    let start_nanos = message.departure_nanos.wrapping_add(message.travel_nanos);
    let work = if message.kind.is_empty() {
        KeptWork::Explore { place: message.place.clone(), information_bits: worth }
    } else {
        KeptWork::Task { name: decode_name(&message.kind, &message.place)?, value: worth, success }
    };
    let end_nanos = start_nanos.wrapping_add(message.duration_nanos);
    Ok(KeptStep { departure_nanos: message.departure_nanos, start_nanos, end_nanos, work })
}

fn encode_plan(plan: &KeptPlan) -> layout::Plan {
    let KeptPlan { day, made_nanos, steps } = plan;
    layout::Plan { day: day.0, made_nanos: *made_nanos, steps: steps.iter().map(encode_step).collect() }
}

fn decode_plan(message: &layout::Plan) -> Result<KeptPlan, Invalid> {
    let steps = message.steps.iter().map(decode_step).collect::<Result<_, _>>()?;
    Ok(KeptPlan { day: LocalDay(message.day), made_nanos: message.made_nanos, steps })
}

pub(in crate::record) fn encode_run(run: &TaskRun) -> layout::TaskRun {
    let TaskRun { name, start_nanos, end_nanos, success, intervention, reason } = run;
    layout::TaskRun {
        kind: name.kind.as_str().to_owned(),
        node: name.node.as_str().to_owned(),
        start_nanos: *start_nanos,
        duration_nanos: end_nanos.wrapping_sub(*start_nanos),
        success: *success,
        intervention: *intervention,
        reason: reason.clone(),
    }
}

pub(in crate::record) fn decode_run(message: &layout::TaskRun) -> Result<TaskRun, Invalid> {
    let layout::TaskRun { kind, node, start_nanos, duration_nanos, success, intervention, reason } = message;
    if kept_reason(reason) != *reason {
        return Err("the reason of a report is too long or does not print");
    }
    let run = TaskRun {
        name: decode_name(kind, node)?,
        start_nanos: *start_nanos,
        end_nanos: start_nanos.wrapping_add(*duration_nanos),
        success: *success,
        intervention: *intervention,
        reason: reason.clone(),
    };
    run.check().map_err(|_| "the times of a report are not valid")?;
    Ok(run)
}

fn decode_book(message: &layout::TaskBook) -> Result<TaskBook, String> {
    let mut book = TaskBook::default();
    let mut apply = |edit| book.apply(&edit).map_err(|error| error.to_string());
    for task in &message.tasks {
        apply(TaskEdit::Set(decode_task(task)?))?;
    }
    for plan in &message.plans {
        apply(TaskEdit::KeepPlan(decode_plan(plan)?))?;
    }
    let mut runs = TaskRuns::default();
    for run in &message.runs {
        runs.add(decode_run(run)?);
    }
    Ok(book.with_runs(runs))
}

fn encode_change(edit: &TaskEdit) -> layout::TaskEdit {
    let change = match edit {
        TaskEdit::Set(task) => layout::TaskChange::Set(encode_task(task)),
        TaskEdit::Remove(TaskName { kind, node }) => layout::TaskChange::Remove(layout::TaskName {
            kind: kind.as_str().to_owned(),
            node: node.as_str().to_owned(),
        }),
        TaskEdit::KeepPlan(plan) => layout::TaskChange::KeepPlan(encode_plan(plan)),
    };
    layout::TaskEdit { change: Some(change) }
}

fn decode_change(message: &layout::TaskEdit) -> Result<TaskEdit, Invalid> {
    Ok(match message.change.as_ref().ok_or("an edit of the tasks changes nothing")? {
        layout::TaskChange::Set(task) => TaskEdit::Set(decode_task(task)?),
        layout::TaskChange::Remove(layout::TaskName { kind, node }) => TaskEdit::Remove(decode_name(kind, node)?),
        layout::TaskChange::KeepPlan(plan) => TaskEdit::KeepPlan(decode_plan(plan)?),
    })
}

pub(super) enum Tasks {}

impl StoredTable for Tasks {
    const NUMBER: u32 = 7;
    type Row = layout::TaskBook;
    type Edit = layout::TaskEdit;

    fn count(site: &Site) -> usize {
        usize::from(*site.tasks() != TaskBook::default())
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::TaskBook> {
        let book = site.tasks();
        let row = || layout::TaskBook {
            tasks: book.tasks().map(encode_task).collect(),
            plans: book.plans().map(encode_plan).collect(),
            runs: book.runs().oldest_first().map(encode_run).collect(),
        };
        (*book != TaskBook::default()).then(row).into_iter()
    }

    fn restore(site: Site, rows: Vec<layout::TaskBook>, _: usize) -> Result<Site, String> {
        let [row] = rows.as_slice() else { return Err("a map has one book of tasks at most".to_owned()) };
        Ok(site.with_tasks(decode_book(row)?))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::TaskEdit> {
        if let SiteEdit::Task(edit) = edit { Some(encode_change(edit)) } else { None }
    }

    fn decode_edit(edit: layout::TaskEdit) -> Result<SiteEdit, Invalid> {
        Ok(SiteEdit::Task(decode_change(&edit)?))
    }
}
