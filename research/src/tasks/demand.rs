//! The demand of a day: tasks at random nodes with random windows, and charging in each part of the day.
//!
//! Invariant: the tasks of a day depend on the seed, the day and their number only. Names are unique on a day.

use std::ops::Range;

use rand::Rng as _;
use tidemap_map::{
    name::{InvalidName, StateName, TaskName},
    task::{CHARGE_KIND, RobotTask, TaskDays},
};
use tidemap_model::LocalDay;

use crate::routes::{START_DAY, building::draw};

const MINUTE: u32 = 60;
const HOUR: u32 = 60 * MINUTE;
/// Windows lie between these times of a day, in seconds: the robot may work then.
pub(super) const WORKING_SECS: Range<u32> = 5 * HOUR..23 * HOUR;
/// The node where the robot charges.
const DOCK: &str = "dock";
/// The robot charges for this long, once in each part of the day of this length.
const CHARGE_SECS: u32 = 30 * MINUTE;
const CHARGE_EVERY_SECS: u32 = 4 * HOUR + 30 * MINUTE;
/// More than all else that could be done meanwhile.
const CHARGE_VALUE: f64 = 20.0;
/// Length of the other windows, and how long their tasks take, in minutes.
const WINDOW_MINUTES: Range<u32> = 60..240;
const DURATION_MINUTES: Range<u32> = 5..25;
/// The values of the other tasks.
const VALUES: Range<u32> = 1..6;
/// Key of the draws, apart from the draws of the building.
const DEMAND: u64 = u64::MAX - 1;

/// The tasks of a day, counted from 0, at these nodes.
pub(super) fn tasks(seed: u64, day: usize, count: usize, nodes: &[StateName]) -> Result<Vec<RobotTask>, InvalidName> {
    let date = TaskDays::On(local_day(day));
    let charge = RobotTask {
        name: TaskName::new(CHARGE_KIND, DOCK)?,
        from_secs: WORKING_SECS.start,
        until_secs: WORKING_SECS.end,
        duration_secs: CHARGE_SECS,
        days: date,
        every_secs: Some(CHARGE_EVERY_SECS),
        value: CHARGE_VALUE,
        value_state: None,
    };
    let mut random = draw(seed, [DEMAND, 0, day as u64]);
    let mut tasks = vec![charge];
    for number in 1..=count {
        let node = nodes[random.random_range(0..nodes.len())].clone();
        let window_secs = MINUTE * random.random_range(WINDOW_MINUTES);
        let from_secs = random.random_range(WORKING_SECS.start..WORKING_SECS.end - window_secs);
        tasks.push(RobotTask {
            name: TaskName { kind: StateName::new(&format!("job-{number}"))?, node },
            from_secs,
            until_secs: from_secs + window_secs,
            duration_secs: MINUTE * random.random_range(DURATION_MINUTES),
            days: date,
            every_secs: None,
            value: f64::from(random.random_range(VALUES)),
            value_state: None,
        });
    }
    Ok(tasks)
}

/// A day, counted from 0.
pub(super) fn local_day(day: usize) -> LocalDay {
    LocalDay(START_DAY + day as i32)
}
