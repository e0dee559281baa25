//! When a search gives up.
//!
//! Invariant: a stop cuts off the end of a walk and changes nothing before it.

use super::plan::Plan;

/// What ends a walk before all places are visited; by default nothing does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stop {
    /// End once the probability of all goals not yet visited, over that of all goals, is below this; 0 to 1.
    pub remains_below: Option<f64>,
    /// What a second of search costs, in units of what finding is worth; 0 up. The walk ends where what is still to be gained,
    /// probability by probability, is worth less than the time to expect it to take.
    pub cost_per_sec: Option<f64>,
    /// Seconds after the start by which the robot has to be at the last place; 0 up. The order is that of a search without end.
    pub within_secs: Option<f64>,
}

/// Why a walk ends before all goals are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stopped {
    /// What remains is below the limit.
    Unlikely,
    /// What remains is not worth the time.
    NotWorthIt,
    /// The time is over.
    OutOfTime,
}

/// A limit of the stop rule that is none.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StopError {
    /// Of what remains.
    #[error("a search is to stop when less than {0} remains: expected 0 to 1")]
    Remains(f64),
    /// Of what a second costs.
    #[error("a second of search costs {0}: expected 0 up")]
    Cost(f64),
    /// Of how long it may take.
    #[error("a search may take {0} s: expected 0 up")]
    Within(f64),
}

impl Stop {
    pub(super) fn check(&self) -> Result<(), StopError> {
        match (self.remains_below, self.cost_per_sec) {
            (Some(below), _) if !(0.0..=1.0).contains(&below) => Err(StopError::Remains(below)),
            (_, Some(cost)) if !(0.0..=f64::MAX).contains(&cost) => Err(StopError::Cost(cost)),
            _ => match self.within_secs.filter(|secs| !(0.0..=f64::MAX).contains(secs)) {
                Some(secs) => Err(StopError::Within(secs)),
                None => Ok(()),
            },
        }
    }

    /// Cuts a plan.
    pub(super) fn apply(&self, plan: &mut Plan) {
        let unlikely = self.remains_below.map_or(plan.steps.len(), |below| steps_until_unlikely(plan, below));
        let worth = self.cost_per_sec.map_or(plan.steps.len(), |cost| steps_worth_it(plan, cost));
        let in_time = self
            .within_secs
            .map_or(plan.steps.len(), |within| plan.steps.partition_point(|step| step.arrival_secs <= within));
        let kept = unlikely.min(worth).min(in_time);
        if kept >= plan.steps.len() {
            return;
        }
        plan.stopped = Some(match kept {
            kept if kept == unlikely => Stopped::Unlikely,
            kept if kept == worth => Stopped::NotWorthIt,
            _ => Stopped::OutOfTime,
        });
        let left = plan.steps[kept..].iter().map(|step| step.probability).sum();
        plan.steps.truncate(kept);
        let end_secs = plan.steps.last().map_or(0.0, |step| step.arrival_secs);
        let walked = plan.walk.partition_point(|passage| passage.arrival_secs <= end_secs);
        plan.walk.truncate(walked);
        plan.summarise(left);
    }
}

/// How many steps are taken until less than this share remains.
fn steps_until_unlikely(plan: &Plan, below: f64) -> usize {
    let all = plan.steps.iter().map(|step| step.probability).sum::<f64>()
        + plan.unreachable.iter().map(|goal| goal.probability).sum::<f64>();
    let mut left = all;
    for (taken, step) in plan.steps.iter().enumerate() {
        // Rounding may leave a little of nothing.
        if left < below * all || left <= 1e-12 * all && below > 0.0 {
            return taken;
        }
        left -= step.probability;
    }
    plan.steps.len()
}

/// After how many steps the gain less the cost of the time to expect is greatest.
fn steps_worth_it(plan: &Plan, cost_per_sec: f64) -> usize {
    let sum: f64 = plan.steps.iter().map(|step| step.probability).sum();
    // More than one person may be there: then one of them is at the goals for sure.
    let scale = if sum > 1.0 { 1.0 / sum } else { 1.0 };
    let (mut found, mut found_secs) = (0.0, 0.0);
    let (mut best, mut most) = (0, 0.0);
    for (taken, step) in plan.steps.iter().enumerate() {
        found += scale * step.probability;
        found_secs += scale * step.probability * step.arrival_secs;
        let search_secs = found_secs + (1.0 - found).max(0.0) * step.arrival_secs;
        let net = found - cost_per_sec * search_secs;
        if net >= most {
            (best, most) = (taken + 1, net);
        }
    }
    best
}
