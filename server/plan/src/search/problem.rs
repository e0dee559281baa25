//! The numbers of a search: goals with weights, and times between them.
//!
//! Invariant: times, which include the time of observing, obey the triangle inequality, because they are shortest
//! times; weights are above 0 and, with that of the start, add up to one. So a walk that passes a goal whose
//! observation takes no time loses nothing by counting it as visited.

use tidemap_map::topology::{Roads, ShortestTimes};

/// A set of goals, as bits.
pub(super) type Goals = u64;

/// Goals 0 to `count`, and the start, which has the index `count`.
#[derive(Clone, Debug)]
pub(super) struct SearchProblem {
    /// Number of goals, without the start.
    pub count: usize,
    /// The weight of each goal.
    pub weight: Vec<f64>,
    /// Seconds from the arrival at one goal to the arrival at another, row by row, including the observation of the
    /// former; the last row is the start's, the last column is unused.
    secs: Vec<f64>,
    /// Whether observing the goal takes no time, so that passing it is a visit.
    pub passable: Vec<bool>,
}

impl SearchProblem {
    /// The search problem of goals, given as indices of nodes with their weights, from the start node.
    pub(super) fn new(roads: &Roads, start: usize, goals: &[(usize, f64)]) -> SearchProblem {
        let count = goals.len();
        let mut secs = vec![0.0; (count + 1) * (count + 1)];
        let mut shortest = ShortestTimes::default();
        for (from, row) in secs.chunks_exact_mut(count + 1).enumerate() {
            let (node, dwell_secs) = goals.get(from).map_or((start, 0.0), |&(node, _)| (node, roads.dwell_secs(node)));
            shortest.from(roads, node);
            for (secs, &(to, _)) in row.iter_mut().zip(goals) {
                *secs = dwell_secs + shortest.secs()[to];
            }
        }
        SearchProblem {
            count,
            weight: goals.iter().map(|&(_, weight)| weight).collect(),
            secs,
            passable: goals.iter().map(|&(node, _)| roads.dwell_secs(node) == 0.0).collect(),
        }
    }

    /// Replaces missing paths by a time longer than any possible walk. Returns whether there were any: a goal without a
    /// way back.
    pub(crate) fn fill_missing(&mut self) -> bool {
        let longest = self.secs.iter().copied().filter(|secs| secs.is_finite()).fold(1.0, f64::max);
        let mut missing = false;
        for secs in self.secs.iter_mut().filter(|secs| secs.is_infinite()) {
            *secs = longest * 4.0 * (self.count + 1) as f64;
            missing = true;
        }
        missing
    }

    /// Seconds from one arrival to the next.
    #[inline]
    pub(super) fn secs(&self, from: usize, to: usize) -> f64 {
        self.secs[from * (self.count + 1) + to]
    }

    /// Seconds from the arrival at a goal to the arrivals at all goals.
    #[inline]
    pub(super) fn row(&self, from: usize) -> &[f64] {
        &self.secs[from * (self.count + 1)..][..self.count]
    }

    /// Sum over the goals, in this order, of weight times arrival: the expected time (eq. 2).
    pub(super) fn expected_secs(&self, order: &[usize]) -> f64 {
        let (mut at, mut now_secs, mut expected_secs) = (self.count, 0.0, 0.0);
        for &goal in order {
            now_secs += self.secs(at, goal);
            expected_secs += self.weight[goal] * now_secs;
            at = goal;
        }
        expected_secs
    }

    /// The search with its goals in another order.
    pub(crate) fn reordered(&self, order: &[usize]) -> SearchProblem {
        let mut secs = Vec::with_capacity(self.secs.len());
        for from in order.iter().copied().chain([self.count]) {
            secs.extend(order.iter().map(|&to| self.secs(from, to)));
            secs.push(0.0);
        }
        SearchProblem {
            count: self.count,
            weight: order.iter().map(|&goal| self.weight[goal]).collect(),
            secs,
            passable: order.iter().map(|&goal| self.passable[goal]).collect(),
        }
    }
}

/// The goals on the way to others, for as many goals as a set has bits.
#[derive(Clone, Debug)]
pub(super) struct Passing {
    count: usize,
    /// The goals on a shortest way between two goals that are visited by passing, by origin and destination.
    between: Vec<Goals>,
    /// The goals that every walk from the start visits before a goal, by goal.
    before: Vec<Goals>,
}

impl Passing {
    /// Times within this share of each other count as equal.
    const SAME: f64 = 1e-12;

    pub(super) fn new(problem: &SearchProblem) -> Passing {
        let count = problem.count;
        let mut between = vec![0; (count + 1) * count];
        for via in (0..count).filter(|&via| problem.passable[via]) {
            for from in (0..=count).filter(|&from| from != via) {
                let to_via = problem.secs(from, via);
                let row = problem.row(from).iter().zip(problem.row(via));
                for (to, (&direct, &onward)) in row.enumerate() {
                    if to != via && to != from && to_via + onward <= direct * (1.0 + Self::SAME) {
                        between[from * count + to] |= 1 << via;
                    }
                }
            }
        }
        Passing { count, between, before: vec![0; count] }
    }

    /// Determines the goals that every walk from the start to another goal must pass.
    pub(crate) fn find_before(&mut self, problem: &SearchProblem, roads: &Roads, start: usize, goals: &[(usize, f64)]) {
        let mut shortest = ShortestTimes::default();
        for via in (0..self.count).filter(|&via| problem.passable[via]) {
            let closed = goals[via].0;
            shortest.from_through(roads, start, |node| node != closed);
            for (goal, &(node, _)) in goals.iter().enumerate() {
                if goal != via && shortest.secs()[node].is_infinite() {
                    self.before[goal] |= 1 << via;
                }
            }
        }
    }

    /// The table for the search after [`SearchProblem::reordered`].
    pub(crate) fn reordered(&self, order: &[usize]) -> Passing {
        let mut place = [0_u32; Goals::BITS as usize];
        for (new, &old) in order.iter().enumerate() {
            place[old] = new as u32;
        }
        let moved = |mut goals: Goals| {
            let mut moved = 0;
            while goals != 0 {
                moved |= 1 << place[goals.trailing_zeros() as usize];
                goals &= goals - 1;
            }
            moved
        };
        let from = || order.iter().copied().chain([self.count]);
        Passing {
            count: self.count,
            between: from()
                .flat_map(|from| order.iter().map(move |&to| (from, to)))
                .map(|(from, to)| moved(self.between(from, to)))
                .collect(),
            before: order.iter().map(|&goal| moved(self.before[goal])).collect(),
        }
    }

    /// Goals that are visited on the way from one goal, or from the start, to another.
    #[inline]
    pub(super) fn between(&self, from: usize, to: usize) -> Goals {
        self.between[from * self.count + to]
    }

    /// Whether some walk may visit `to` next after `from`, considering only goals in `among`.
    pub(crate) fn may_follow(&self, from: usize, to: usize, among: Goals) -> bool {
        if from == to {
            return false;
        }
        let mut between = self.between(from, to) & among;
        if from == self.count {
            return between == 0;
        }
        while between != 0 {
            let via = between.trailing_zeros() as usize;
            // The goal lies behind `from`, so it is not visited yet, and would be on the way.
            if self.before[via] & (1 << from) != 0 {
                return false;
            }
            between &= between - 1;
        }
        self.before[from] & (1 << to) == 0
    }
}
