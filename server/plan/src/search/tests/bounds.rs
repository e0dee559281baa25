//! Lower bounds against the true cost of every state.

use super::*;
use crate::search::{machine::Machine, paths::Paths, problem::Goals};

/// The cost of visiting a set of goals from one of them, by sets and goals; the first set is empty.
fn costs_behind(problem: &SearchProblem) -> Vec<f64> {
    let count = problem.count;
    let mut costs = vec![0.0; (1 << count) * (count + 1)];
    for left in 1..1_usize << count {
        let charge: f64 = (0..count).filter(|goal| left & (1 << goal) != 0).map(|goal| problem.weight[goal]).sum();
        for from in 0..=count {
            let onward = (0..count).filter(|to| left & (1 << to) != 0);
            let cost = onward.map(|to| problem.secs(from, to) * charge + costs[(left & !(1 << to)) * (count + 1) + to]);
            costs[left * (count + 1) + from] = cost.fold(f64::INFINITY, f64::min);
        }
    }
    costs
}

/// Whether a walk that passes no unvisited goal may have visited a goal with exactly these left.
fn is_possible(passing: &Passing, count: usize, left: Goals, at: usize) -> bool {
    let all = (1 << count) - 1;
    let mut reached = std::collections::BTreeSet::from([(0, count)]);
    loop {
        let mut next = reached.clone();
        for &(visited, from) in &reached {
            let free = (0..count).filter(|to| visited & (1 << to) == 0);
            next.extend(
                free.filter(|&to| passing.between(from, to) & !visited & all == 0).map(|to| (visited | 1 << to, to)),
            );
        }
        if next.len() == reached.len() {
            return reached.contains(&(all & !left, at));
        }
        reached = next;
    }
}

#[test]
fn no_bound_is_above_the_true_cost_of_any_state() {
    let mut tight = 0;
    for seed in 0..60 {
        let (shape, whole) = (SHAPES[seed as usize % 4], seed / 4 % 2 == 0);
        let mut map = Map::random(shape, 7, whole, 500 + seed);
        if seed % 3 == 0 {
            map = with_looks(map, seed);
        }
        let roads = map.roads();
        let goals: Vec<(usize, f64)> = map
            .goals
            .iter()
            .skip(1)
            .map(|&(node, probability)| (node.0 as usize, probability.max(FLOOR) / 7.0))
            .collect();
        let problem = SearchProblem::new(&roads, 0, &goals);
        let (count, costs) = (problem.count, costs_behind(&problem));
        let mut passing = Passing::new(&problem);
        passing.find_before(&problem, &roads, 0, &goals);
        let best = costs[((1 << count) - 1) * (count + 1) + count];
        let machine = Machine::new(&problem, Some(&passing));
        assert!(machine.root <= best * (1.0 + 1e-12), "{shape:?} {seed}: {} above {best}", machine.root);
        for units in [16, 200] {
            let mut paths = Paths::new(&problem, &passing, units);
            paths.improve(60, best, || false);
            assert!(paths.root <= best * (1.0 + 1e-9), "{shape:?} {seed}: {} above {best}", paths.root);
            tight += usize::from(paths.root > 0.9 * best);
            for left in 1..1 << count {
                for at in (0..count).filter(|at| left & (1 << at) != 0) {
                    let rest = left & !(1 << at);
                    let bound = paths.behind(left, paths.sums(left), at);
                    let cost = costs[rest as usize * (count + 1) + at];
                    let holds = bound <= cost + 1e-9 * best;
                    assert!(holds || !is_possible(&passing, count, rest, at), "{shape:?} {seed}: {bound} above {cost}");
                }
            }
        }
    }
    assert!(tight > 60, "only {tight} of 120 bounds come within a tenth of the best");
}
