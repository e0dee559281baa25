//! The plan of a search: the order of visits with their times, and the walk.
//!
//! Invariant: arrivals ascend along the walk, and every step is on it.

use tidemap_map::topology::{NodeId, Roads, ShortestTimes};

use super::{
    Goal,
    question::{GoalOrder, SearchQuestion},
    stop::{Stop, StopReason},
};

/// A visit to a node, which the planner identifies by number and users by name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchStep<N = NodeId> {
    /// The node.
    pub node: N,
    /// Time at which the robot is at the node, seconds after it leaves the start.
    pub arrival_secs: f64,
    /// Probability of finding the target at the node, as given.
    pub probability: f64,
}

/// A node on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// The node.
    pub node: NodeId,
    /// Time at which the robot is at the node, seconds after it leaves the start.
    pub arrival_secs: f64,
}

/// A planned search.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchPlan {
    /// Visits in order, including places that are passed on the way to others.
    pub steps: Vec<SearchStep>,
    /// All nodes on the way, the start first; a node that is passed twice appears twice.
    pub walk: Vec<Passage>,
    /// Expected time to find the target, in seconds, given that it is at one of the steps (Waldo eq. 2, divided by the
    /// sum of the steps' probabilities).
    pub expected_secs: f64,
    /// Lower bound of the expected time of all walks to all goals, before any stop.
    pub lower_bound_secs: f64,
    /// Whether the order is proven to be the best, before any stop.
    pub optimal: bool,
    /// Goals that cannot be reached from the start, or that cannot be reached any more once the others are visited.
    pub unreachable: Vec<Goal>,
    /// Remaining probability: the sum over all goals that are not a step, divided by the sum over all goals; 0 to 1.
    pub remains: f64,
    /// The reason why the walk ends before all goals are visited, if it does.
    pub stopped: Option<StopReason>,
    /// Number of states of the exact search; 0 for a heuristic one.
    pub states: usize,
    /// Minimum probability of a goal.
    pub(super) floor: f64,
}

impl SearchPlan {
    /// Walks the order along shortest paths.
    pub(super) fn of(roads: &Roads, question: &SearchQuestion, ordered: &GoalOrder, floor: f64) -> SearchPlan {
        let mut probability_at = vec![None; roads.len()];
        for &(node, probability) in &question.goals {
            probability_at[node] = Some(probability);
        }
        let mut walk = vec![Passage { node: roads.node(question.start), arrival_secs: 0.0 }];
        let mut steps = Vec::with_capacity(ordered.nodes.len());
        let mut unreachable = question.unreachable.clone();
        let (mut at, mut now_secs) = (question.start, 0.0);
        let mut shortest = ShortestTimes::default();
        for &goal in &ordered.nodes {
            // The goal was already passed.
            let Some(probability) = probability_at[goal] else { continue };
            shortest.between(roads, at, goal);
            if shortest.secs()[goal].is_infinite() {
                unreachable.push(Goal { node: roads.node(goal), probability });
                continue;
            }
            for stop in shortest.way_to(goal) {
                let arrival_secs = now_secs + stop.secs;
                walk.push(Passage { node: roads.node(stop.node), arrival_secs });
                let passable = stop.node != goal && roads.dwell_secs(stop.node) == 0.0;
                if let Some(probability) = probability_at[stop.node].filter(|_| passable) {
                    steps.push(SearchStep { node: roads.node(stop.node), arrival_secs, probability });
                    probability_at[stop.node] = None;
                }
            }
            now_secs += shortest.secs()[goal];
            steps.push(SearchStep { node: roads.node(goal), arrival_secs: now_secs, probability });
            probability_at[goal] = None;
            now_secs += roads.dwell_secs(goal);
            at = goal;
        }
        let mut plan = SearchPlan {
            steps,
            walk,
            expected_secs: 0.0,
            lower_bound_secs: 0.0,
            optimal: ordered.complete,
            unreachable,
            remains: 0.0,
            stopped: None,
            states: ordered.states,
            floor,
        };
        debug_assert!(
            plan.walk.is_sorted_by(|a, b| a.arrival_secs <= b.arrival_secs),
            "arrivals ascend along the walk"
        );
        debug_assert!(plan.steps.is_sorted_by(|a, b| a.arrival_secs <= b.arrival_secs), "arrivals of steps ascend");
        plan.summarise(0.0);
        plan.lower_bound_secs = ordered.lower_bound_secs.min(plan.expected_secs);
        plan
    }

    /// Recomputes the sums over the steps; `left` is the probability of the steps that were cut off.
    pub(super) fn summarise(&mut self, left: f64) {
        let counts = |step: &SearchStep| step.probability.max(self.floor);
        let sum: f64 = self.steps.iter().map(counts).sum();
        let cost: f64 = self.steps.iter().map(|step| counts(step) * step.arrival_secs).sum();
        self.expected_secs = if sum > 0.0 { cost / sum } else { 0.0 };
        let seen: f64 = self.steps.iter().map(|step| step.probability).sum();
        let unseen = left + self.unreachable.iter().map(|goal| goal.probability).sum::<f64>();
        // If all probabilities are 0, nothing remains.
        self.remains = if unseen > 0.0 { unseen / (seen + unseen) } else { 0.0 };
    }
}

impl Stop {
    /// Cuts off the end of a plan.
    pub(super) fn apply(&self, plan: &mut SearchPlan) {
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
            kept if kept == unlikely => StopReason::Unlikely,
            kept if kept == worth => StopReason::NotWorthIt,
            _ => StopReason::OutOfTime,
        });
        let left = plan.steps[kept..].iter().map(|step| step.probability).sum();
        plan.steps.truncate(kept);
        let end_secs = plan.steps.last().map_or(0.0, |step| step.arrival_secs);
        let walked = plan.walk.partition_point(|passage| passage.arrival_secs <= end_secs);
        plan.walk.truncate(walked);
        plan.summarise(left);
    }
}

/// Number of steps until less than this share remains.
fn steps_until_unlikely(plan: &SearchPlan, below: f64) -> usize {
    let all = plan.steps.iter().map(|step| step.probability).sum::<f64>()
        + plan.unreachable.iter().map(|goal| goal.probability).sum::<f64>();
    let mut left = all;
    for (taken, step) in plan.steps.iter().enumerate() {
        // Rounding may leave a small remainder.
        if left < below * all || left <= 1e-12 * all && below > 0.0 {
            return taken;
        }
        left -= step.probability;
    }
    plan.steps.len()
}

/// Number of steps that maximises the gain minus the cost of the expected time.
fn steps_worth_it(plan: &SearchPlan, cost_per_sec: f64) -> usize {
    let sum: f64 = plan.steps.iter().map(|step| step.probability).sum();
    // With several targets, one of them is certainly at the goals.
    let scale = if sum > 1.0 { 1.0 / sum } else { 1.0 };
    let (mut found, mut found_secs) = (0.0, 0.0);
    let (mut best, mut best_net) = (0, 0.0);
    for (taken, step) in plan.steps.iter().enumerate() {
        found += scale * step.probability;
        found_secs += scale * step.probability * step.arrival_secs;
        let search_secs = found_secs + (1.0 - found).max(0.0) * step.arrival_secs;
        let net = found - cost_per_sec * search_secs;
        if net >= best_net {
            (best, best_net) = (taken + 1, net);
        }
    }
    best
}
