//! Iterated local search: a good walk fast, with no promise.
//!
//! A greedy walk is improved, disturbed by exchanging two short stretches, and improved again where it was disturbed; what is
//! hardly worse than the best is gone on from, now and then the best itself. The same seed gives the same walk.

use rand::{Rng, SeedableRng, rngs::SmallRng};

use super::{
    local::{Near, Walk},
    problem::Problem,
};

/// Longest stretch that a disturbance exchanges.
const DISTURBED_MAX: usize = 30;
/// Neighbours that are looked at; all of small searches.
const NEAR: usize = 40;
/// Rounds without a better walk after which the search goes on from its best.
const PATIENCE: u32 = 400;
/// A walk that is by this share worse than the best may be gone on from.
const TOLERANCE: f64 = 0.003;

/// An order of the goals that is good, after so many disturbances or when asked to stop.
pub(super) fn iterate(problem: &Problem, rounds: usize, seed: u64, mut until: impl FnMut() -> bool) -> Vec<usize> {
    let near = Near::new(problem, NEAR);
    let mut best = Walk::new(problem, &near, &greedy(problem));
    best.improve(&mut until);
    if problem.count < 3 {
        return best.order().to_vec();
    }
    let mut random = SmallRng::seed_from_u64(seed);
    let mut walk = best.clone();
    let (mut accepted, mut patience) = (best.clone(), 0);
    for _ in 0..rounds {
        if until() {
            break;
        }
        disturb(&mut walk, problem.count, &mut random);
        walk.improve(&mut until);
        if walk.cost() < best.cost() * (1.0 - 1e-12) {
            best.copy_from(&walk);
            accepted.copy_from(&walk);
            patience = 0;
            continue;
        }
        patience += 1;
        if patience > PATIENCE {
            patience = 0;
            accepted.copy_from(&best);
        } else if walk.cost() < accepted.cost().max(best.cost() * (1.0 + TOLERANCE * random.random::<f64>().powi(2))) {
            accepted.copy_from(&walk);
        }
        walk.copy_from(&accepted);
    }
    best.order().to_vec()
}

fn disturb(walk: &mut Walk<'_>, count: usize, random: &mut SmallRng) {
    let longest = DISTURBED_MAX.min(count / 2).max(1);
    let (first, second) = (random.random_range(1..=longest), random.random_range(1..=longest));
    let second = second.min(count - first);
    let from = random.random_range(1..=count + 1 - first - second);
    walk.exchange(from, from + first - 1, from + first + second - 1);
}

/// Always on to the goal that gains most weight in a second.
fn greedy(problem: &Problem) -> Vec<usize> {
    let mut order = Vec::with_capacity(problem.count);
    let mut left: Vec<usize> = (0..problem.count).collect();
    let mut at = problem.count;
    while !left.is_empty() {
        let rate = |goal: usize| problem.weight[goal] / problem.secs(at, goal).max(f64::MIN_POSITIVE);
        let mut next = 0;
        let mut most = rate(left[0]);
        for (index, &goal) in left.iter().enumerate().skip(1) {
            let found = rate(goal);
            if found > most {
                (next, most) = (index, found);
            }
        }
        at = left.swap_remove(next);
        order.push(at);
    }
    order
}
