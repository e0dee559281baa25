//! A lower bound of the rest of a search: cheapest paths over remaining weight.
//!
//! A walk costs, for each leg, the time times the weight that is still unvisited. With weights rounded down to whole
//! units, the rest of a path depends on the units left and the current goal only. The cheapest path over these states
//! may visit a goal twice, though not directly after leaving it, and costs no more than the best walk (state-space
//! relaxation: Christofides, Mingozzi, Toth, Networks 1981). A reward for each goal, raised if paths omit it and
//! lowered if they visit it twice, tightens the bound (subgradient method). Invariant: the bound is never above the
//! true cost, for any rewards.

use super::problem::{Goals, Passing, SearchProblem};

/// The cheapest path from a state on, and the cheapest with another first goal.
#[derive(Clone, Copy, Debug)]
struct PathStep {
    cost: f64,
    other_cost: f64,
    next: u32,
}

const NO_WAY: PathStep = PathStep { cost: f64::INFINITY, other_cost: f64::INFINITY, next: u32::MAX };
const NONE: u32 = u32::MAX;

/// Bounds for each goal and number of units left.
#[derive(Clone, Debug)]
pub(super) struct Paths {
    count: usize,
    /// Whole units of each goal's weight.
    units: Vec<u32>,
    /// Weight of a unit.
    unit: f64,
    total: u32,
    rewards: Vec<f64>,
    /// The time by destination and origin; infinite if no walk has this succession.
    secs: Vec<f64>,
    onward: Vec<PathStep>,
    /// A bound of the whole search.
    pub root: f64,
}

impl Paths {
    /// Prepares bounds with about the given number of units for the whole weight.
    pub(super) fn new(problem: &SearchProblem, passing: &Passing, units: u32) -> Paths {
        let count = problem.count;
        let mut paths = Paths {
            count,
            units: Vec::new(),
            unit: 1.0,
            total: 0,
            rewards: vec![0.0; count],
            secs: Vec::new(),
            onward: Vec::new(),
            root: 0.0,
        };
        paths.set_units(problem, passing, units);
        paths
    }

    /// Rounds the weights again; the rewards stay.
    pub(crate) fn set_units(&mut self, problem: &SearchProblem, passing: &Passing, max_units: u32) {
        let sum: f64 = problem.weight.iter().sum();
        let units_by = |unit: f64| problem.weight.iter().map(move |weight| (weight / unit * (1.0 + 1e-13)) as u32);
        // Chooses the number of units that loses least; equal weights lose nothing with few.
        let lost = |unit: f64| sum - unit * f64::from(units_by(unit).sum::<u32>());
        let least = (max_units / 2).max(2);
        let few = (1..=256_u32).take_while(|&few| few < least);
        let tried = few.chain((0..64).map(|step| least + (max_units - least) * step / 63));
        let mut best = (f64::INFINITY, 1.0);
        for number in tried {
            let unit = sum / f64::from(number);
            let loss = lost(unit);
            if loss < best.0 - 1e-9 * sum {
                best = (loss, unit);
            }
        }
        self.unit = best.1;
        self.units = units_by(self.unit).collect();
        // The product must stay below the weight, whatever the rounding.
        self.unit *= 1.0 - 1e-12;
        self.total = self.units.iter().sum();
        let kept = |goal: usize| self.units[goal] > 0;
        // If a goal of no units is omitted, the way around it may avoid goals between its neighbours.
        let among = if (0..self.count).all(kept) { Goals::MAX } else { 0 };
        self.secs = (0..self.count)
            .flat_map(|to| (0..=self.count).map(move |from| (from, to)))
            .map(|(from, to)| match passing.may_follow(from, to, among) && kept(to) {
                true => problem.secs(from, to),
                false => f64::INFINITY,
            })
            .collect();
        for (reward, &units) in self.rewards.iter_mut().zip(&self.units) {
            if units == 0 {
                *reward = 0.0;
            }
        }
    }

    /// Computes the bounds for the present rewards.
    fn solve(&mut self) {
        let count = self.count;
        let targets: Vec<usize> = (0..count).filter(|&goal| self.units[goal] > 0).collect();
        self.onward.clear();
        self.onward.resize((self.total as usize + 1) * (count + 1), NO_WAY);
        for nothing_left in &mut self.onward[..=count] {
            *nothing_left = PathStep { cost: 0.0, other_cost: 0.0, next: NONE };
        }
        for left in 1..=self.total {
            let charge = self.unit * f64::from(left);
            let (known, now) = self.onward.split_at_mut(left as usize * (count + 1));
            for &to in targets.iter().filter(|&&to| self.units[to] <= left) {
                let then = known[(left - self.units[to]) as usize * (count + 1) + to];
                if then.cost == f64::INFINITY {
                    continue;
                }
                let reward = self.rewards[to];
                let row = &self.secs[to * (count + 1)..][..=count];
                for (from, onward) in now[..=count].iter_mut().enumerate() {
                    let after = if then.next == from as u32 { then.other_cost } else { then.cost };
                    let cost = row[from] * charge + after - reward;
                    if cost < onward.other_cost {
                        if cost < onward.cost {
                            onward.other_cost = onward.cost;
                            onward.cost = cost;
                            onward.next = to as u32;
                        } else {
                            onward.other_cost = cost;
                        }
                    }
                }
            }
        }
        let whole = self.onward[self.total as usize * (count + 1) + count].cost;
        self.root = whole + self.rewards.iter().sum::<f64>();
    }

    /// Number of visits of the cheapest path to each goal.
    fn visits(&self) -> Vec<f64> {
        let mut visits = vec![0.0; self.count];
        let (mut left, mut at, mut before) = (self.total, self.count, NONE);
        while left > 0 {
            let onward = self.onward[left as usize * (self.count + 1) + at];
            let next = match onward.next == before {
                false => onward.next as usize,
                true => self.second(left, at, onward),
            };
            if next >= self.count {
                break;
            }
            visits[next] += 1.0;
            (before, at) = (at as u32, next);
            left -= self.units[next];
        }
        visits
    }

    /// The first goal of the cheapest path that begins differently from the cheapest of all.
    fn second(&self, left: u32, at: usize, onward: PathStep) -> usize {
        let charge = self.unit * f64::from(left);
        let fits = |to: usize| to != onward.next as usize && self.units[to] > 0 && self.units[to] <= left;
        let cost = |to: usize| {
            let then = self.onward[(left - self.units[to]) as usize * (self.count + 1) + to];
            let after = if then.next == at as u32 { then.other_cost } else { then.cost };
            self.secs[to * (self.count + 1) + at] * charge + after - self.rewards[to]
        };
        (0..self.count).filter(|&to| fits(to)).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(self.count)
    }

    /// Changes the rewards the given number of times, towards a known cost; keeps those of the best bound, and computes
    /// the bounds for them. Stops on request.
    pub(super) fn improve(&mut self, rounds: usize, cost: f64, mut until: impl FnMut() -> bool) {
        let (mut best, mut best_rewards) = (f64::NEG_INFINITY, self.rewards.clone());
        let (mut pace, mut idle) = (1.0, 0);
        for _ in 0..rounds {
            self.solve();
            if self.root > best + cost * 1e-5 {
                idle = 0;
            } else {
                idle += 1;
            }
            if self.root > best {
                best = self.root;
                best_rewards.clone_from(&self.rewards);
            }
            if idle >= 4 {
                (pace, idle) = (pace * 0.6, 0);
            }
            let visits = self.visits();
            let lacks = visits.iter().zip(&self.units).map(|(visits, &units)| match units {
                0 => 0.0,
                _ => 1.0 - visits,
            });
            let square: f64 = lacks.clone().map(|lack| lack * lack).sum();
            if square == 0.0 || best >= cost || pace < 0.01 || until() {
                break;
            }
            let step = pace * (cost - self.root).max(cost * 1e-4) / square;
            for (reward, lack) in self.rewards.iter_mut().zip(lacks) {
                *reward += step * lack;
            }
        }
        self.rewards = best_rewards;
        self.solve();
    }

    /// Units and rewards of a set of goals.
    #[inline]
    pub(super) fn sums(&self, mut goals: Goals) -> (u32, f64) {
        let (mut units, mut rewards) = (0, 0.0);
        while goals != 0 {
            let goal = goals.trailing_zeros() as usize;
            units += self.units[goal];
            rewards += self.rewards[goal];
            goals &= goals - 1;
        }
        (units, rewards)
    }

    /// A bound of the cost of continuing to a goal's successors, given the set that contains it with its sums.
    #[inline]
    pub(super) fn behind(&self, goals: Goals, (units, rewards): (u32, f64), goal: usize) -> f64 {
        let left = units - self.units[goal];
        let onward = self.onward[left as usize * (self.count + 1) + goal];
        // A walk does not continue with a visited goal.
        let fits = onward.next == NONE || goals & (1 << onward.next) != 0;
        rewards - self.rewards[goal] + if fits { onward.cost } else { onward.other_cost }
    }
}
