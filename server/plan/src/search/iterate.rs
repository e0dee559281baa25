//! Iterated local search: finds a good walk quickly, without a guarantee.
//!
//! A greedy walk is improved, perturbed by exchanging two short stretches, and improved again there. Worse walks are
//! accepted as in simulated annealing, in cycles. Each cycle begins hot at the best walk, cools, and is twice as long
//! as the one before, so that a search of any length both cools and escapes local minima. The same seed gives the same
//! walk.

use rand::{Rng, SeedableRng, rngs::SmallRng};

use super::{
    local::{Neighbours, SearchWalk},
    problem::SearchProblem,
};

/// Longest stretch that a perturbation exchanges.
const DISTURBED_MAX: usize = 30;
/// Number of neighbours, alternating by cycle: few neighbours are four times as fast, many escape where few are stuck.
const NEAR: [usize; 2] = [15, 40];
/// Rounds of the first cycle.
const CYCLE: usize = 2_000;
/// Mean relative worsening of an accepted walk at the beginning and at the end of a cycle.
const HOT: f64 = 3e-3;
const COLD: f64 = 1e-4;

/// A good order of the goals, after the given number of perturbations or when stopped.
pub(super) fn iterate(
    problem: &SearchProblem,
    rounds: usize,
    seed: u64,
    mut until: impl FnMut() -> bool,
) -> Vec<usize> {
    let near = Neighbours::new(problem, NEAR[1]);
    let mut best = SearchWalk::new(problem, &near, &greedy(problem));
    best.improve(&mut until);
    if problem.count < 3 {
        return best.order().to_vec();
    }
    let mut random = SmallRng::seed_from_u64(seed);
    let (mut walk, mut accepted) = (best.clone(), best.clone());
    // A short search is a single cycle.
    let (mut cycle, mut done, mut cycles) = (CYCLE.min(rounds), 0, 0);
    walk.consider_nearest(NEAR[0]);
    for _ in 0..rounds {
        if until() {
            break;
        }
        disturb(&mut walk, problem.count, &mut random);
        walk.improve(&mut until);
        if walk.cost() < best.cost() * (1.0 - 1e-12) {
            best.copy_from(&walk);
        }
        let heat = HOT * (COLD / HOT).powf(done as f64 / cycle as f64);
        let worse = -heat * random.random::<f64>().max(f64::MIN_POSITIVE).ln();
        if walk.cost() <= accepted.cost() * (1.0 + worse) {
            accepted.copy_from(&walk);
        }
        done += 1;
        if done == cycle {
            (cycle, done, cycles) = (cycle.saturating_mul(2), 0, cycles + 1);
            accepted.copy_from(&best);
            walk.consider_nearest(NEAR[cycles % NEAR.len()]);
        }
        walk.copy_from(&accepted);
    }
    best.order().to_vec()
}

fn disturb(walk: &mut SearchWalk<'_>, count: usize, random: &mut SmallRng) {
    let longest = DISTURBED_MAX.min(count / 2).max(1);
    let (first, second) = (random.random_range(1..=longest), random.random_range(1..=longest));
    let second = second.min(count - first);
    let from = random.random_range(1..=count + 1 - first - second);
    walk.exchange(from, from + first - 1, from + first + second - 1);
}

/// Greedy order: always goes to the goal with the most weight per second.
fn greedy(problem: &SearchProblem) -> Vec<usize> {
    let mut order = Vec::with_capacity(problem.count);
    let mut left: Vec<usize> = (0..problem.count).collect();
    let mut at = problem.count;
    while !left.is_empty() {
        let rate = |goal: usize| problem.weight[goal] / problem.secs(at, goal).max(f64::MIN_POSITIVE);
        let mut next = 0;
        let mut best_rate = rate(left[0]);
        for (index, &goal) in left.iter().enumerate().skip(1) {
            let found = rate(goal);
            if found > best_rate {
                (next, best_rate) = (index, found);
            }
        }
        at = left.swap_remove(next);
        order.push(at);
    }
    order
}
