//! `tidemap task` and `tidemap plan`.
//!
//! Invariant: a change is durable when the command ends; tasks are listed by kind and node, steps of a plan by time.

use std::process::ExitCode;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use tidemap_client::{
    clock,
    tasks::{AllowedHours, KeptStep, KeptWork, LocalDay, RobotTask, TaskDays, TaskName, TaskRun, TaskWeek},
};
use tidemap_formats::table::Cell;

use super::{Session, producer_id, times, usage};
use crate::progress::status_line;

/// Default label of reports.
const LABEL: &str = "tasks";
const SEC_NANOS: i64 = 1_000_000_000;
const DAY_SECS: u32 = 86_400;
const WEEKDAYS: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];

#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Adds a task of a robot at a node of the topological map; replaces the task of that kind and node
    Add(Box<AddArgs>),
    /// Lists the tasks of a map
    List {
        /// Name of the map
        map: String,
    },
    /// Removes a task; its learned data stays
    Remove {
        /// Name of the map
        map: String,
        /// Kind of work
        kind: String,
        /// Node where it is done
        node: String,
    },
    /// Reports that a robot did a task, or tried to
    ///
    /// It is one observation of the state task/KIND/NODE: 1 if the task succeeded, else 0. With --sequence a report
    /// that is sent again is taken once.
    Report(Box<ReportArgs>),
    /// Shows how much the robots of a map work by themselves, week by week
    ///
    /// autonomy_percent is the time in which tasks were performed, of the time in which the robot was allowed to work
    /// by itself; charging does not count. lifetime_secs is the longest time that was reached in the week without an
    /// intervention.
    Weeks {
        /// Name of the map
        map: String,
        /// Hours in which the robot may work by itself [default: the whole day]
        #[arg(long, value_name = "HH:MM-HH:MM", value_parser = hours)]
        hours: Option<(u32, u32)>,
        /// Days on which it may, such as mon-fri or mon,wed [default: all]
        #[arg(long, value_name = "DAYS", value_parser = weekdays)]
        days: Option<u8>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct AddArgs {
    /// Name of the map
    map: String,
    /// Kind of work; the kind charge charges the robot
    kind: String,
    /// Node where it is done
    node: String,
    /// Local time from which on it may begin [default: 00:00]
    #[arg(long, value_name = "HH:MM", value_parser = clock_secs, default_value = "00:00")]
    from: u32,
    /// Local time by which it has ended [default: 24:00]
    #[arg(long, value_name = "HH:MM", value_parser = clock_secs, default_value = "24:00")]
    until: u32,
    /// Duration of the work
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    duration: i64,
    /// Does it once in each part of this length between --from and --until
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    every: Option<i64>,
    /// Days on which it is done, such as mon-fri or mon,wed [default: all]
    #[arg(long, value_name = "DAYS", value_parser = weekdays, conflicts_with = "date")]
    days: Option<u8>,
    /// The only date on which it is done
    #[arg(long, value_name = "YYYY-MM-DD")]
    date: Option<String>,
    /// Value of the task
    #[arg(long, value_name = "V", default_value_t = 1.0)]
    value: f64,
    /// State whose probability at the time multiplies the value
    #[arg(long, value_name = "STATE")]
    value_state: Option<String>,
}

#[derive(Debug, Args)]
pub(crate) struct ReportArgs {
    /// Name of the map
    map: String,
    /// Kind of work
    kind: String,
    /// Node where it was done
    node: String,
    /// Time when the robot began
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    start: i64,
    /// Time when it ended or gave up, within a day [default: now]
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    end: Option<i64>,
    /// Whether it succeeded
    #[arg(long, value_name = "true|false", action = clap::ArgAction::Set)]
    success: bool,
    /// Reason of a failure, at most 200 characters
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    reason: String,
    /// Somebody had to help without a request from the robot
    #[arg(long)]
    intervention: bool,
    /// Name of the producer [default: a name for this user and machine, generated once and kept]
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Label of the sequence
    #[arg(long, value_name = "LABEL", default_value = LABEL)]
    label: String,
    /// Number of the report in its sequence [default: the next one]
    #[arg(long, requires = "end", value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    sequence: Option<u64>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum PlanCommand {
    /// Shows the plan of a day that day --tasks --keep has kept
    ///
    /// now marks the step at the time of --at, from its departure to its end.
    Show {
        /// Name of the map
        map: String,
        /// Local date, such as 2016-03-21 [default: that of --at]
        #[arg(long, value_name = "YYYY-MM-DD")]
        date: Option<String>,
        /// Time of which the step is marked [default: now]
        #[arg(long, value_name = "TIME", value_parser = times::time)]
        at: Option<i64>,
    },
}

/// A time of day as seconds after midnight.
fn clock_secs(text: &str) -> Result<u32, String> {
    let number = |text: &str| text.parse::<u32>().ok().filter(|_| text.len() == 2);
    let secs = text.split_once(':').and_then(|(hours, minutes)| {
        let (hours, minutes) = (number(hours)?, number(minutes).filter(|minutes| *minutes < 60)?);
        Some(hours * 3_600 + minutes * 60)
    });
    let wrong = || format!("{text:?} is not a time of day: use 00:00 to 24:00");
    secs.filter(|secs| *secs <= DAY_SECS).ok_or_else(wrong)
}

fn hours(text: &str) -> Result<(u32, u32), String> {
    let (from, until) = text.split_once('-').ok_or_else(|| format!("{text:?} is not like 08:00-18:00"))?;
    match (clock_secs(from)?, clock_secs(until)?) {
        (from, until) if from < until => Ok((from, until)),
        _ => Err(format!("{text:?} ends before it begins")),
    }
}

/// Days of the week as bits, Monday in the lowest.
fn weekdays(text: &str) -> Result<u8, String> {
    let day = |name: &str| {
        let known = WEEKDAYS.iter().position(|known| *known == name);
        known.ok_or_else(|| format!("{name:?} is not a day: use {}, or mon-fri", WEEKDAYS.join(", ")))
    };
    let mut days = 0;
    for part in text.split(',') {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let (first, last) = (day(first)?, day(last)?);
        // From Saturday to Monday the week begins anew.
        let count = (last + 7 - first) % 7 + 1;
        days |= (first..first + count).fold(0_u8, |days, day| days | 1 << (day % 7));
    }
    Ok(days)
}

fn shown_clock(secs: u32) -> String {
    format!("{:02}:{:02}", secs / 3_600, secs / 60 % 60)
}

fn shown_days(days: TaskDays) -> String {
    match days {
        TaskDays::Weekly(days) => {
            let on: Vec<&str> = (0..7).filter(|day| days & (1 << day) != 0).map(|day| WEEKDAYS[day]).collect();
            on.join(",")
        }
        TaskDays::On(day) => day.to_string(),
    }
}

/// Whole seconds of an option.
fn whole_secs(option: &str, nanos: i64) -> anyhow::Result<u32> {
    let secs = u32::try_from(nanos / SEC_NANOS).ok().filter(|_| nanos % SEC_NANOS == 0 && nanos > 0);
    secs.ok_or_else(|| usage(format!("--{option}: it has to be whole seconds, and at least one")))
}

const COLUMNS: [&str; 9] =
    ["kind", "node", "from", "until", "duration_secs", "days", "every_secs", "value", "value_state"];

fn row(task: &RobotTask) -> Vec<Cell> {
    vec![
        task.name.kind.as_str().into(),
        task.name.node.as_str().into(),
        Cell::Text(shown_clock(task.from_secs)),
        Cell::Text(shown_clock(task.until_secs)),
        u64::from(task.duration_secs).into(),
        Cell::Text(shown_days(task.days)),
        task.every_secs.map_or(Cell::Empty, |secs| u64::from(secs).into()),
        task.value.into(),
        task.value_state.as_ref().map_or(Cell::Empty, |state| state.as_str().into()),
    ]
}

pub(crate) async fn run(session: &Session, command: TaskCommand) -> anyhow::Result<ExitCode> {
    match command {
        TaskCommand::Add(args) => {
            let task = session.client.set_task(&args.map, &task(&args)?).await?;
            session.print(&COLUMNS, [row(&task)])
        }
        TaskCommand::List { map } => {
            let tasks = session.client.tasks(&map).await?;
            session.print(&COLUMNS, tasks.iter().map(row))
        }
        TaskCommand::Remove { map, kind, node } => {
            session.client.remove_task(&map, &kind, &node).await?;
            status_line(&format!("task {kind}/{node} is removed; its learned data stays"));
            Ok(ExitCode::SUCCESS)
        }
        TaskCommand::Report(args) => report(session, *args).await,
        TaskCommand::Weeks { map, hours, days } => {
            let all = AllowedHours::default();
            let (from_secs, until_secs) = hours.unwrap_or((all.from_secs, all.until_secs));
            let hours = AllowedHours { from_secs, until_secs, weekdays: days.unwrap_or(all.weekdays) };
            weeks(session, &session.client.task_weeks(&map, hours).await?)
        }
    }
}

/// The task of the options.
fn task(args: &AddArgs) -> anyhow::Result<RobotTask> {
    let day =
        args.date.as_deref().map(|date| LocalDay::parse(date).ok_or_else(|| usage(format!("{date:?} is no date"))));
    Ok(RobotTask {
        name: TaskName::new(&args.kind, &args.node)?,
        from_secs: args.from,
        until_secs: args.until,
        duration_secs: whole_secs("duration", args.duration)?,
        days: match day.transpose()? {
            Some(day) => TaskDays::On(day),
            None => TaskDays::Weekly(args.days.unwrap_or(AllowedHours::default().weekdays)),
        },
        every_secs: args.every.map(|every| whole_secs("every", every)).transpose()?,
        value: args.value,
        value_state: args.value_state.as_deref().map(tidemap_client::maps::StateName::stored_or_label).transpose()?,
    })
}

async fn report(session: &Session, args: ReportArgs) -> anyhow::Result<ExitCode> {
    let producer = match args.producer {
        Some(producer) => producer,
        None => producer_id::of_user()?,
    };
    let run = TaskRun {
        name: TaskName::new(&args.kind, &args.node)?,
        start_nanos: args.start,
        end_nanos: args.end.unwrap_or_else(clock::now_nanos),
        success: args.success,
        intervention: args.intervention,
        reason: args.reason,
    };
    let key = (producer.as_str(), args.label.as_str());
    let receipt = session.client.report_task(&args.map, key, args.sequence.unwrap_or(0), &run).await?;
    let is_refused = receipt.refused.is_some();
    let cells = vec![
        producer.as_str().into(),
        args.label.as_str().into(),
        receipt.durable_sequence.into(),
        Cell::Flag(is_refused),
    ];
    session.print(&["producer", "label", "durable_sequence", "refused"], [cells])?;
    if let Some(detail) = receipt.refused {
        status_line(&format!("the report is refused: {detail}"));
    }
    Ok(if is_refused { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn weeks(session: &Session, weeks: &[TaskWeek]) -> anyhow::Result<ExitCode> {
    const COLUMNS: [&str; 8] = [
        "monday",
        "runs",
        "failed",
        "interventions",
        "active_secs",
        "allowed_secs",
        "autonomy_percent",
        "lifetime_secs",
    ];
    let row = |week: &TaskWeek| {
        vec![
            Cell::Text(week.monday.to_string()),
            week.runs.into(),
            week.failed.into(),
            week.interventions.into(),
            week.active_secs.into(),
            week.allowed_secs.into(),
            week.autonomy_percent().into(),
            week.lifetime_secs.into(),
        ]
    };
    session.print(&COLUMNS, weeks.iter().map(row))
}

pub(crate) async fn plan(session: &Session, command: PlanCommand) -> anyhow::Result<ExitCode> {
    const COLUMNS: [&str; 9] =
        ["departure", "start", "end", "task", "location", "value", "success", "information_bits", "now"];
    let PlanCommand::Show { map, date, at } = command;
    let (plan, current) = session
        .client
        .kept_plan(&map, date.as_deref(), at)
        .await
        .context("day --tasks --keep plans a day and keeps it")?;
    let row = |(index, step): (usize, &KeptStep)| {
        let (task, location, worth) = match &step.work {
            KeptWork::Task { name, value, success } => {
                (Cell::Text(name.to_string()), Cell::Empty, [(*value).into(), (*success).into(), Cell::Empty])
            }
            KeptWork::Explore { place, information_bits } => {
                (Cell::Empty, Cell::Text(place.clone()), [Cell::Empty, Cell::Empty, (*information_bits).into()])
            }
        };
        let times = [step.departure_nanos, step.start_nanos, step.end_nanos].map(Cell::Time);
        let rest = [Cell::Flag(current == Some(index))];
        times.into_iter().chain([task, location]).chain(worth).chain(rest).collect()
    };
    session.print(&COLUMNS, plan.steps.iter().enumerate().map(row))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_days_are_read_as_people_write_them() {
        assert_eq!((clock_secs("09:30"), clock_secs("24:00")), (Ok(34_200), Ok(86_400)));
        assert_eq!(hours("08:00-18:30"), Ok((28_800, 66_600)));
        assert_eq!((weekdays("mon-fri"), weekdays("sat,mon")), (Ok(31), Ok(0b10_0001)));
        assert_eq!((weekdays("sat-mon"), weekdays("mon-sun")), (Ok(0b110_0001), Ok(127)));
        for wrong in ["9:30", "24:01", "09:60", "noon", ""] {
            assert!(clock_secs(wrong).is_err(), "{wrong:?}");
        }
        assert!(hours("18:00-08:00").is_err() && weekdays("monday").is_err());
    }
}
