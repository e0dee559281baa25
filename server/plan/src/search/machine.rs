//! A lower bound of the rest of a search: jobs of one machine.
//!
//! If every time between arrivals is at least the sum of a share of the departed goal and one of the reached goal, then
//! the arrivals are no earlier than the starts of jobs on one machine, whose best order is that of Smith (1956):
//! ascending by duration over weight. The shares are those of the dual of the assignment problem, or the least times of
//! arriving, whichever bound is better for the whole search. Invariant: the bound is never above the true cost.

use super::problem::{Goals, Passing, SearchProblem};

/// Shares of each goal, and the order of Smith.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    /// Least time of leaving.
    pub leaving: Vec<f64>,
    /// Least time of arriving.
    pub arriving: Vec<f64>,
    /// Goals ascending by duration over weight.
    pub order: Vec<usize>,
    /// A bound of the whole search.
    pub root: f64,
}

impl Machine {
    pub(super) fn new(problem: &SearchProblem, passing: Option<&Passing>) -> Machine {
        let count = problem.count;
        let least = (0..count).map(|to| least_arrival(problem, passing, to)).collect();
        let plain = Machine::of(problem, vec![0.0; count], least);
        if passing.is_none() || count < 2 {
            return plain;
        }
        let (leaving, arriving) = assignment_dual(problem, passing);
        let dual = Machine::of(problem, leaving, arriving);
        if dual.root > plain.root { dual } else { plain }
    }

    fn of(problem: &SearchProblem, leaving: Vec<f64>, arriving: Vec<f64>) -> Machine {
        let count = problem.count;
        let mut order: Vec<usize> = (0..count).collect();
        let ratio = |goal: usize| (leaving[goal] + arriving[goal]) / problem.weight[goal];
        order.sort_by(|&a, &b| ratio(a).total_cmp(&ratio(b)));
        // Leaving the start takes the least remainder of its row.
        let row = problem.row(count).iter().zip(&arriving);
        let mut now = row.map(|(secs, arriving)| secs - arriving).fold(f64::INFINITY, f64::min);
        let mut root = 0.0;
        for &goal in &order {
            root += problem.weight[goal] * (now + arriving[goal]);
            now += arriving[goal] + leaving[goal];
        }
        Machine { leaving, arriving, order, root }
    }

    /// These shares, for the search after [`SearchProblem::reordered`] by [`Machine::order`].
    pub(super) fn sorted(&self) -> Machine {
        Machine {
            leaving: self.order.iter().map(|&goal| self.leaving[goal]).collect(),
            arriving: self.order.iter().map(|&goal| self.arriving[goal]).collect(),
            order: (0..self.order.len()).collect(),
            root: self.root,
        }
    }
}

/// The least time in which a goal is reached from another or from the start.
fn least_arrival(problem: &SearchProblem, passing: Option<&Passing>, to: usize) -> f64 {
    let follows = |from: usize| from != to && passing.is_none_or(|passing| passing.may_follow(from, to, Goals::MAX));
    let from = (0..=problem.count).filter(|&from| follows(from));
    let least = from.map(|from| problem.secs(from, to)).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

/// Shares of the dual of the assignment problem (each goal is left once and reached once), by shortest augmenting
/// paths.
fn assignment_dual(problem: &SearchProblem, passing: Option<&Passing>) -> (Vec<f64>, Vec<f64>) {
    let count = problem.count;
    let longest = (0..count).flat_map(|from| problem.row(from)).copied().fold(0.0, f64::max);
    // Successions that no walk has are expensive, so that they do not limit the shares.
    let cost = |from: usize, to: usize| {
        let follows = from != to && passing.is_none_or(|passing| passing.may_follow(from, to, Goals::MAX));
        if follows { problem.secs(from, to) } else { 4.0 * longest }
    };
    let costs: Vec<f64> = (0..count * count).map(|pair| cost(pair / count, pair % count)).collect();
    let (mut leaving, mut arriving) = (vec![0.0; count + 1], vec![0.0; count + 1]);
    // The row that each column has; the last column represents the row that is being placed.
    let mut row_of = vec![usize::MAX; count + 1];
    let mut before = vec![0; count];
    let (mut slack, mut done) = (vec![0.0; count], vec![false; count + 1]);
    for row in 0..count {
        row_of[count] = row;
        slack.fill(f64::INFINITY);
        done.fill(false);
        let mut column = count;
        while row_of[column] != usize::MAX {
            done[column] = true;
            let here = row_of[column];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for to in (0..count).filter(|&to| !done[to]) {
                let reduced = costs[here * count + to] - leaving[here] - arriving[to];
                if reduced < slack[to] {
                    slack[to] = reduced;
                    before[to] = column;
                }
                if slack[to] < step {
                    step = slack[to];
                    next = to;
                }
            }
            for to in 0..=count {
                if done[to] {
                    leaving[row_of[to]] += step;
                    arriving[to] -= step;
                } else if to < count {
                    slack[to] -= step;
                }
            }
            column = next;
        }
        while column != count {
            row_of[column] = row_of[before[column]];
            column = before[column];
        }
        row_of[count] = usize::MAX;
    }
    leaving.truncate(count);
    arriving.truncate(count);
    // Rounding must not raise a sum of shares above the time itself.
    let slip = longest * 1e-14 * count as f64;
    leaving.iter_mut().for_each(|share| *share -= slip);
    (leaving, arriving)
}
