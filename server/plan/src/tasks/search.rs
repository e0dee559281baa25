//! A good order of many tasks: each task is inserted where it is worth most, then single tasks are moved while this
//! improves the order.
//!
//! Invariant: the result depends only on the request; the work is bounded by counted steps, not by time.

use tidemap_model::StopSignal;

use super::{
    TaskPlanError,
    exact::VALUE_TIE,
    timing::{Choice, Moves, Timing},
};

/// Maximum number of timed tasks while orders are improved.
const STEPS_MAX: usize = 600_000;
/// Maximum number of partial plans that are kept for an order: the plans that are worth most.
const FRONT_MAX: usize = 12;

/// A partial plan of an order.
#[derive(Clone, Copy)]
struct Partial {
    value: f64,
    end_secs: f64,
    before: usize,
    choice: Option<Choice>,
}

/// An order of tasks, with its value and end.
#[derive(Clone, Debug)]
struct Order {
    tasks: Vec<usize>,
    value: f64,
    end_secs: f64,
}

impl Order {
    fn is_better_than(&self, other: &Order) -> bool {
        let is_equal = (self.value - other.value).abs() <= VALUE_TIE;
        if is_equal { self.end_secs < other.end_secs - 1e-6 } else { self.value > other.value }
    }
}

struct Search<'t, 'a, 's> {
    timing: &'t mut Timing<'a>,
    steps: usize,
    stop: StopSignal<'s>,
}

/// A good plan of the tasks; `None` without tasks.
pub(super) fn search_order(
    timing: &mut Timing<'_>,
    tasks: &[usize],
    stop: StopSignal<'_>,
) -> Result<Option<Moves>, TaskPlanError> {
    if tasks.is_empty() {
        return Ok(None);
    }
    let ready_secs = timing.day.ready_secs;
    let mut search = Search { timing, steps: 0, stop };
    let mut order = Order { tasks: Vec::new(), value: 0.0, end_secs: ready_secs };
    let mut rest = tasks.to_vec();
    // The tasks with the greatest value per second come first, so that they get the best places.
    let rate = |task: &usize| search.timing.greatest[*task].0 / search.timing.day.tasks[*task].duration_secs;
    let rates: Vec<f64> = rest.iter().map(rate).collect();
    let mut by_rate: Vec<usize> = (0..rest.len()).collect();
    by_rate.sort_by(|one, other| rates[*other].total_cmp(&rates[*one]).then(one.cmp(other)));
    rest = by_rate.into_iter().map(|index| rest[index]).collect();
    search.insert(&mut order, &mut rest)?;
    search.steps = 0;
    while search.steps < STEPS_MAX && search.improve(&mut order, &mut rest)? {}
    Ok(Some(search.realise(&order.tasks)))
}

impl Search<'_, '_, '_> {
    /// Inserts each remaining task where the order becomes best.
    fn insert(&mut self, order: &mut Order, rest: &mut Vec<usize>) -> Result<bool, TaskPlanError> {
        let mut left = Vec::new();
        for &task in &*rest {
            let mut best: Option<Order> = None;
            for place in 0..=order.tasks.len() {
                let mut tasks = order.tasks.clone();
                tasks.insert(place, task);
                if let Some(tried) = self.tried(tasks)?
                    && best.as_ref().is_none_or(|best| tried.is_better_than(best))
                {
                    best = Some(tried);
                }
            }
            match best.filter(|best| best.value > order.value + VALUE_TIE) {
                Some(best) => *order = best,
                None => left.push(task),
            }
        }
        let has_inserted = left.len() < rest.len();
        *rest = left;
        Ok(has_inserted)
    }

    /// Moves one task, or exchanges one for a remaining task, if the order becomes better.
    fn improve(&mut self, order: &mut Order, rest: &mut Vec<usize>) -> Result<bool, TaskPlanError> {
        let count = order.tasks.len();
        for from in 0..count {
            for to in 0..count {
                // The exchange of two neighbours is tried only once.
                if from == to || from == to + 1 {
                    continue;
                }
                let mut tasks = order.tasks.clone();
                let task = tasks.remove(from);
                tasks.insert(to, task);
                if self.takes(order, tasks)? {
                    self.insert(order, rest)?;
                    return Ok(true);
                }
            }
        }
        for place in 0..count {
            for other in 0..rest.len() {
                let mut tasks = order.tasks.clone();
                let out = tasks.remove(place);
                let candidate = rest[other];
                for to in 0..=tasks.len() {
                    let mut with = tasks.clone();
                    with.insert(to, candidate);
                    if self.takes(order, with)? {
                        rest[other] = out;
                        self.insert(order, rest)?;
                        return Ok(true);
                    }
                }
            }
        }
        Ok(false)
    }

    fn takes(&mut self, order: &mut Order, tasks: Vec<usize>) -> Result<bool, TaskPlanError> {
        if self.steps >= STEPS_MAX {
            return Ok(false);
        }
        let better = self.tried(tasks)?.filter(|tried| tried.is_better_than(order));
        let Some(better) = better else { return Ok(false) };
        *order = better;
        Ok(true)
    }

    /// The order with its value; `None` where not all of its tasks can be done.
    fn tried(&mut self, tasks: Vec<usize>) -> Result<Option<Order>, TaskPlanError> {
        self.stop.check()?;
        let fronts = self.fronts(&tasks);
        let best = fronts.and_then(|fronts| fronts.last().and_then(|front| best_of(front).map(|at| front[at])));
        Ok(best.map(|Partial { value, end_secs, .. }| Order { tasks, value, end_secs }))
    }

    /// The partial plans after each task of an order; `None` where a task cannot be done.
    fn fronts(&mut self, tasks: &[usize]) -> Option<Vec<Vec<Partial>>> {
        let day = self.timing.day;
        let mut fronts = vec![vec![Partial { value: 0.0, end_secs: day.ready_secs, before: 0, choice: None }]];
        let mut place = day.start;
        for &task in tasks {
            self.steps += 1;
            let mut front: Vec<Partial> = Vec::new();
            for (before, partial) in fronts.last()?.iter().enumerate() {
                for choice in self.timing.choices(place, task, partial.end_secs) {
                    let (value, end_secs) = (partial.value + choice.worth, choice.end_secs);
                    front.push(Partial { value, end_secs, before, choice: Some(choice) });
                }
            }
            // The earliest plan comes first; each later one is worth more.
            front.sort_by(|one, other| one.end_secs.total_cmp(&other.end_secs).then(other.value.total_cmp(&one.value)));
            let mut greatest = f64::NEG_INFINITY;
            front.retain(|partial| {
                let is_more = partial.value > greatest;
                greatest = greatest.max(partial.value);
                is_more
            });
            if front.len() > FRONT_MAX {
                // The earliest plan stays, so that an order that can be done is found.
                front.drain(1..front.len() + 1 - FRONT_MAX);
            }
            if front.is_empty() {
                return None;
            }
            fronts.push(front);
            place = day.tasks[task].place;
        }
        Some(fronts)
    }

    /// The plan of an order that can be done.
    fn realise(&mut self, tasks: &[usize]) -> Moves {
        let Some(fronts) = self.fronts(tasks) else { return Moves::default() };
        let Some(mut at) = fronts.last().and_then(|front| best_of(front)) else { return Moves::default() };
        let value = fronts.last().map_or(0.0, |front| front[at].value);
        let mut chosen = Vec::with_capacity(tasks.len());
        for (front, &task) in fronts.iter().skip(1).zip(tasks).rev() {
            let Partial { before, choice, .. } = front[at];
            chosen.extend(choice.map(|choice| (task, choice)));
            at = before;
        }
        chosen.reverse();
        Moves { value, chosen }
    }
}

/// Index of the partial plan that is worth most: the last, because the worths ascend.
fn best_of(front: &[Partial]) -> Option<usize> {
    front.len().checked_sub(1)
}
