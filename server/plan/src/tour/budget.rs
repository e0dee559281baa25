//! Selects the goals that fit into the time of a tour.
//!
//! Invariant: the drive through the kept goals fits into the time.

use super::order::Ways;

/// The costs and the time limit of a tour.
#[derive(Debug)]
pub(super) struct TourBudget<'a> {
    pub ways: &'a Ways<'a>,
    /// The value of each goal.
    pub values: &'a [f64],
    /// Seconds a metre.
    pub secs_m: f64,
    /// Seconds at each goal.
    pub observation_secs: f64,
    /// The time limit, seconds; infinite without a limit.
    pub budget_secs: f64,
}

impl TourBudget<'_> {
    /// The duration of a drive, observations included.
    pub(super) fn duration_secs(&self, order: &[usize]) -> f64 {
        self.ways.length(order) * self.secs_m + order.len() as f64 * self.observation_secs
    }

    fn fits(&self, order: &[usize]) -> bool {
        self.duration_secs(order) <= self.budget_secs
    }

    /// The duration of the tour to the single cheapest goal.
    pub(super) fn least_secs(&self) -> f64 {
        (0..self.ways.count()).map(|goal| self.duration_secs(&[goal])).fold(f64::INFINITY, f64::min)
    }

    /// The goals that fit, in the order of the drive. First removes the goals that do not fit even alone, then, one
    /// after the other, those with the least value for the time that they add; finally puts back those that fit after
    /// all, the most valuable first.
    pub(super) fn select(&self) -> Vec<usize> {
        let mut goals: Vec<usize> = (0..self.ways.count()).filter(|&goal| self.fits(&[goal])).collect();
        let mut left_out = Vec::new();
        let mut order = self.ways.order(&goals);
        while !self.fits(&order) && !self.ways.stop.is_set() {
            let whole = self.duration_secs(&order);
            let value_of_time = |goal: usize| {
                let rest: Vec<usize> = order.iter().copied().filter(|&other| other != goal).collect();
                let added = whole - self.duration_secs(&rest);
                if added > 0.0 { self.values[goal] / added } else { f64::INFINITY }
            };
            let worse = |one: &usize, other: &usize| value_of_time(*one).total_cmp(&value_of_time(*other));
            let Some(worst) = goals.iter().copied().min_by(worse) else { break };
            goals.retain(|&goal| goal != worst);
            left_out.push(worst);
            order = self.ways.order(&goals);
        }
        left_out.sort_by(|&one, &other| self.values[other].total_cmp(&self.values[one]).then(one.cmp(&other)));
        for goal in left_out.into_iter().take_while(|_| !self.ways.stop.is_set()) {
            goals.push(goal);
            let longer = self.ways.order(&goals);
            if self.fits(&longer) {
                order = longer;
            } else {
                goals.pop();
            }
        }
        debug_assert!(self.ways.stop.is_set() || order.is_empty() || self.fits(&order), "the drive fits into the time");
        order
    }
}
