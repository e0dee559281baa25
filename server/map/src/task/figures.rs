//! How much a robot works by itself, week by week: A % and TSL of IEEE RAM 2017, "Metrics".
//!
//! A % is the time during which tasks were performed, as a share of the time in which the robot was allowed to work by
//! itself. Charging is no performed task. TSL, the total system lifetime, is the time for which the system was
//! available. A failure from which it did not recover by itself, and help for which it did not ask, begin a new
//! lifetime. A lifetime counts from the first report after such an event to the end of the last report before the next
//! event.
//!
//! Invariant: the figures follow from the reports alone. Time that two reports cover counts once. The first and the
//! last week count from the day of the first report to that of the last.

use tidemap_model::{LocalDay, Zone};

use super::{ALL_WEEKDAYS, CHARGE_KIND, DAY_SECS, TaskRun, TaskRuns, local_nanos};

/// The hours in which a robot may work by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AllowedHours {
    /// Beginning, seconds after local midnight.
    pub from_secs: u32,
    /// End, seconds after local midnight.
    pub until_secs: u32,
    /// A bit for each day of the week, Monday in the lowest.
    pub weekdays: u8,
}

impl Default for AllowedHours {
    fn default() -> Self {
        Self { from_secs: 0, until_secs: DAY_SECS, weekdays: ALL_WEEKDAYS }
    }
}

/// The figures of a week.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskWeek {
    /// The Monday with which the week begins.
    pub monday: LocalDay,
    /// Number of reported tasks that began in the week.
    pub runs: u64,
    /// Number of these tasks that failed.
    pub failed: u64,
    /// Number of these tasks after which a person had to help.
    pub interventions: u64,
    /// Allowed time in which tasks were performed, seconds.
    pub active_secs: f64,
    /// Time in which the robot was allowed to work by itself, seconds.
    pub allowed_secs: f64,
    /// The longest total system lifetime that was reached in the week, seconds. It may have begun before.
    pub lifetime_secs: f64,
}

impl TaskWeek {
    /// A %: the active share of the allowed time, in percent; 0 where no time was allowed.
    #[must_use]
    pub fn autonomy_percent(&self) -> f64 {
        if self.allowed_secs > 0.0 { 100.0 * self.active_secs / self.allowed_secs } else { 0.0 }
    }
}

/// The figures of all weeks from the first report to the last.
#[must_use]
pub fn task_weeks(runs: &TaskRuns, zone: &Zone, hours: AllowedHours) -> Vec<TaskWeek> {
    let all: Vec<&TaskRun> = runs.oldest_first().collect();
    let (Some(first), Some(last_nanos)) = (all.first(), all.iter().map(|run| run.end_nanos).max()) else {
        return Vec::new();
    };
    let (first_day, last_day) = (zone.day_of(first.start_nanos), zone.day_of(last_nanos));
    let (active, lifetimes) = (active_spans(&all), lifetimes(&all));
    let monday_of = |day: LocalDay| LocalDay(day.0 - day.weekday() as i32);
    let mut weeks = Vec::new();
    let mut monday = monday_of(first_day);
    while monday <= last_day {
        let next = LocalDay(monday.0 + 7);
        let days = (monday.0.max(first_day.0)..next.0.min(last_day.0 + 1)).map(LocalDay);
        let allowed: Vec<(i64, i64)> = days
            .filter(|day| hours.weekdays & (1 << day.weekday()) != 0)
            .map(|day| (local_nanos(zone, day, hours.from_secs), local_nanos(zone, day, hours.until_secs)))
            .collect();
        let (from, until) = (zone.midnight_nanos(monday), zone.midnight_nanos(next));
        let begun = || all.iter().filter(|run| (from..until).contains(&run.start_nanos));
        let reached = lifetimes.iter().filter(|(begin, end)| *begin < until && *end >= from);
        let longest = reached.map(|(begin, end)| end.min(&until) - begin).max().unwrap_or(0);
        weeks.push(TaskWeek {
            monday,
            runs: begun().count() as u64,
            failed: begun().filter(|run| !run.success).count() as u64,
            interventions: begun().filter(|run| run.intervention).count() as u64,
            active_secs: common_nanos(&active, &allowed) as f64 / 1e9,
            allowed_secs: allowed.iter().map(|(from, until)| until - from).sum::<i64>() as f64 / 1e9,
            lifetime_secs: longest as f64 / 1e9,
        });
        monday = next;
    }
    weeks
}

/// The times in which tasks were performed: ascending, without overlap.
fn active_spans(runs: &[&TaskRun]) -> Vec<(i64, i64)> {
    let mut spans: Vec<(i64, i64)> = Vec::new();
    for run in runs.iter().filter(|run| run.name.kind.as_str() != CHARGE_KIND) {
        match spans.last_mut() {
            Some((_, end)) if run.start_nanos <= *end => *end = run.end_nanos.max(*end),
            _ => spans.push((run.start_nanos, run.end_nanos)),
        }
    }
    spans
}

/// The lifetimes of the system, from begin to end.
fn lifetimes(runs: &[&TaskRun]) -> Vec<(i64, i64)> {
    let mut lifetimes: Vec<(i64, i64)> = Vec::new();
    let mut goes_on = false;
    for run in runs {
        match lifetimes.last_mut() {
            Some((_, end)) if goes_on => *end = run.end_nanos.max(*end),
            _ => lifetimes.push((run.start_nanos, run.end_nanos)),
        }
        goes_on = !run.intervention;
    }
    lifetimes
}

/// The time that both lists have in common; each ascends without overlap.
fn common_nanos(one: &[(i64, i64)], other: &[(i64, i64)]) -> i64 {
    let (mut common, mut at) = (0, 0);
    for (from, until) in other {
        while one.get(at).is_some_and(|(_, end)| end <= from) {
            at += 1;
        }
        for (begin, end) in one[at..].iter().take_while(|(begin, _)| begin < until) {
            common += (*end.min(until) - *begin.max(from)).max(0);
        }
    }
    common
}
