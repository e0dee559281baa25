//! Finds the times at which a task can be done from a place, and the worth of each.
//!
//! Invariant: of two choices, the one that ends later is worth more. No time between the tried times is better than all
//! of them.

use super::{DayTask, LegTable, TaskDay, TaskStep, TaskValue};

/// Time before the end of a slot at which a robot departs that has to depart in this slot.
const LATE_SECS: f64 = 1.0;

/// One way to do a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub departure_secs: f64,
    pub start_secs: f64,
    pub end_secs: f64,
    pub value: f64,
    pub success: f64,
    /// Worth of the choice in a plan.
    pub worth: f64,
}

/// Tasks in their order, each with its choice.
#[derive(Clone, Debug, Default)]
pub(super) struct Moves {
    pub value: f64,
    pub chosen: Vec<(usize, Choice)>,
}

impl Moves {
    /// The steps, each with the latest departure that costs nothing.
    pub(super) fn steps(&self, day: &TaskDay<'_>) -> Vec<TaskStep> {
        let mut from = day.start;
        let mut steps = Vec::with_capacity(self.chosen.len());
        for &(task, choice) in &self.chosen {
            let place = day.tasks[task].place;
            let (departure_secs, success) = latest_departure(day.legs, (from, place), &choice);
            let Choice { start_secs, end_secs, value, .. } = choice;
            steps.push(TaskStep { task, departure_secs, start_secs, end_secs, value, success });
            from = place;
        }
        steps
    }
}

/// The latest departure that arrives by the start with no less success, and its success.
fn latest_departure(legs: &LegTable, (from, to): (usize, usize), choice: &Choice) -> (f64, f64) {
    let first_slot = legs.slot_of(choice.departure_secs);
    for slot in (first_slot..=legs.slot_of(choice.start_secs)).rev() {
        let Some(leg) = legs.at(from, to, slot).filter(|leg| leg.success >= choice.success) else { continue };
        let end_secs = (slot + 1) as f64 * legs.slot_secs();
        let is_last = slot + 1 == legs.slots();
        let latest_secs = choice.start_secs - leg.secs;
        let departure_secs = if is_last || latest_secs < end_secs { latest_secs } else { end_secs - LATE_SECS };
        if departure_secs >= choice.departure_secs && (slot == first_slot || legs.slot_of(departure_secs) == slot) {
            return (departure_secs, leg.success);
        }
    }
    (choice.departure_secs, choice.success)
}

/// An arrival at a task.
#[derive(Clone, Copy, Debug)]
struct TaskArrival {
    /// Time at which the task can begin.
    start_secs: f64,
    slot: usize,
    departure_secs: f64,
    success: f64,
}

/// The times of a day.
pub(super) struct Timing<'a> {
    pub day: &'a TaskDay<'a>,
    /// For each task: the greatest value, and the greatest success of a leg to the task.
    pub greatest: Vec<(f64, f64)>,
    arrivals: Vec<TaskArrival>,
}

impl<'a> Timing<'a> {
    pub(super) fn new(day: &'a TaskDay<'a>) -> Self {
        let legs = day.legs;
        let greatest = |task: &DayTask| {
            let values = (0..legs.slots()).map(|slot| task.value.at(slot));
            let from = (0..legs.places()).flat_map(|from| (0..legs.slots()).map(move |slot| (from, slot)));
            let successes = from.filter_map(|(from, slot)| legs.at(from, task.place, slot)).map(|leg| leg.success);
            let success = if task.persists { 1.0 } else { successes.fold(0.0, f64::max) };
            (values.fold(0.0, f64::max), success)
        };
        Timing { day, greatest: day.tasks.iter().map(greatest).collect(), arrivals: Vec::new() }
    }

    /// The choices for a task, for a robot that is ready at a place, ascending by end and by worth.
    pub(super) fn choices(&mut self, from: usize, task: usize, ready_secs: f64) -> Vec<Choice> {
        let day = self.day;
        let DayTask { place, from_secs, until_secs, duration_secs, ref value, .. } = day.tasks[task];
        let latest_secs = until_secs - duration_secs;
        self.arrive((from, place), ready_secs, (from_secs, latest_secs));
        let (greatest_value, greatest_success) = self.greatest[task];
        let enough = greatest_value * greatest_success;
        let mut choices: Vec<Choice> = Vec::new();
        let Some(first) = self.arrivals.first() else { return choices };
        let varies = matches!(value, TaskValue::BySlot(_));
        let (mut next_slot, mut arrived) = (first.slot + 1, 0);
        let mut best: Option<TaskArrival> = None;
        loop {
            let boundary_secs = next_slot as f64 * day.legs.slot_secs();
            let is_boundary = varies && next_slot < day.legs.slots() && boundary_secs <= latest_secs;
            let arrival = self.arrivals.get(arrived).copied();
            let (start_secs, slot) = match arrival {
                Some(arrival) if !is_boundary || arrival.start_secs <= boundary_secs => {
                    arrived += 1;
                    if best.is_none_or(|best| arrival.success > best.success) {
                        best = Some(arrival);
                    }
                    (arrival.start_secs, arrival.slot)
                }
                _ if is_boundary => {
                    next_slot += 1;
                    (boundary_secs, next_slot - 1)
                }
                _ => break,
            };
            let Some(best) = best else { continue };
            let (value, success) = (value.at(slot), best.success);
            let worth = day.tasks[task].worth(value, success);
            if worth > choices.last().map_or(0.0, |choice| choice.worth) {
                let (departure_secs, end_secs) = (best.departure_secs, start_secs + duration_secs);
                choices.push(Choice { departure_secs, start_secs, end_secs, value, success, worth });
                if worth >= enough {
                    break;
                }
            }
        }
        choices
    }

    /// Finds the arrivals, ascending.
    fn arrive(&mut self, (from, to): (usize, usize), ready_secs: f64, (from_secs, latest_secs): (f64, f64)) {
        let legs = self.day.legs;
        self.arrivals.clear();
        let ready_slot = legs.slot_of(ready_secs);
        for departure_slot in ready_slot..legs.slots() {
            let departure_secs =
                if departure_slot == ready_slot { ready_secs } else { departure_slot as f64 * legs.slot_secs() };
            if departure_secs > latest_secs {
                break;
            }
            let Some(leg) = legs.at(from, to, departure_slot) else { continue };
            let start_secs = (departure_secs + leg.secs).max(from_secs);
            if start_secs > latest_secs {
                continue;
            }
            let slot = legs.slot_of(start_secs);
            self.arrivals.push(TaskArrival { start_secs, slot, departure_secs, success: leg.success });
            if from == to {
                break;
            }
        }
        self.arrivals.sort_by(|one, other| one.start_secs.total_cmp(&other.start_secs));
    }
}
