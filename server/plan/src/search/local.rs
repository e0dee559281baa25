//! Local search: small changes of walks, each evaluated in constant time.
//!
//! A change reassembles a few stretches of the old walk, forwards or backwards. Sums along the walk, in both
//! directions, give the duration, weight and cost of each stretch (Silva, Subramanian, Vidal, Ochi: A simple and
//! effective metaheuristic for the Minimum Latency Problem, EJOR 2012). Invariant: a walk has each goal once, and its
//! sums are those of its order.

use super::problem::SearchProblem;

/// Longest stretch that is moved elsewhere.
const MOVED_MAX: usize = 3;
/// Minimum relative improvement of a change: less is rounding.
const GAIN_MIN: f64 = 1e-11;

/// The nearest goals of each goal and of the start.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    each: usize,
    goals: Vec<u32>,
}

impl Neighbours {
    pub(super) fn new(problem: &SearchProblem, max_count: usize) -> Neighbours {
        let each = max_count.min(problem.count.saturating_sub(1)).max(1);
        let mut goals = Vec::with_capacity((problem.count + 1) * each);
        let mut sorted: Vec<u32> = Vec::with_capacity(problem.count);
        for from in 0..=problem.count {
            let row = problem.row(from);
            sorted.clear();
            sorted.extend((0..problem.count as u32).filter(|&to| to as usize != from));
            let by_secs = |a: &u32, b: &u32| row[*a as usize].total_cmp(&row[*b as usize]);
            if sorted.len() > each {
                sorted.select_nth_unstable_by(each - 1, by_secs);
                sorted.truncate(each);
            }
            sorted.sort_unstable_by(by_secs);
            goals.extend(sorted.iter().copied().chain(std::iter::repeat(0)).take(each));
        }
        Neighbours { each, goals }
    }

    fn of(&self, goal: usize) -> &[u32] {
        &self.goals[goal * self.each..][..self.each]
    }
}

/// A stretch of a walk, by its first and last position; with `back` it is walked from the last to the first.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    first: usize,
    last: usize,
    back: bool,
}

/// Sums up to a position of a walk.
#[derive(Clone, Copy, Debug, Default)]
struct PrefixSums {
    /// Arrival at the position, seconds.
    secs: f64,
    weight: f64,
    /// Weight times arrival.
    cost: f64,
    /// The duration of the way back to the first goal.
    back_secs: f64,
    /// Weight times the duration of the way back.
    back_cost: f64,
}

/// A walk: the start at position 0, then each goal.
#[derive(Clone, Debug)]
pub(super) struct SearchWalk<'a> {
    problem: &'a SearchProblem,
    near: &'a Neighbours,
    /// Number of nearest goals that are considered.
    reach: usize,
    goals: Vec<usize>,
    position: Vec<usize>,
    sums: Vec<PrefixSums>,
    /// Goals whose surroundings have changed since they were checked.
    open: Vec<usize>,
    is_open: Vec<bool>,
    spare: Vec<usize>,
}

impl<'a> SearchWalk<'a> {
    pub(super) fn new(problem: &'a SearchProblem, near: &'a Neighbours, order: &[usize]) -> SearchWalk<'a> {
        let mut walk = SearchWalk {
            problem,
            near,
            reach: usize::MAX,
            goals: std::iter::once(problem.count).chain(order.iter().copied()).collect(),
            position: vec![0; problem.count + 1],
            sums: vec![PrefixSums::default(); problem.count + 1],
            open: Vec::with_capacity(problem.count + 1),
            is_open: vec![false; problem.count + 1],
            spare: Vec::new(),
        };
        walk.sum_from(1);
        for position in (0..=problem.count).rev() {
            walk.reopen(position);
        }
        walk
    }

    /// Sets the number of nearest goals that are considered.
    pub(crate) fn consider_nearest(&mut self, reach: usize) {
        self.reach = reach;
    }

    /// The goals in order.
    pub(super) fn order(&self) -> &[usize] {
        &self.goals[1..]
    }

    /// The expected time.
    pub(super) fn cost(&self) -> f64 {
        self.sums[self.problem.count].cost
    }

    /// Copies another walk's order, whose goals are all checked.
    pub(crate) fn copy_from(&mut self, other: &SearchWalk<'_>) {
        self.goals.clone_from(&other.goals);
        self.position.clone_from(&other.position);
        self.sums.clone_from(&other.sums);
        self.open.clear();
        self.is_open.fill(false);
    }

    fn sum_from(&mut self, first: usize) {
        for at in first..self.goals.len() {
            let (previous, goal, weight) = (self.goals[at - 1], self.goals[at], self.problem.weight[self.goals[at]]);
            let before = self.sums[at - 1];
            let secs = before.secs + self.problem.secs(previous, goal);
            let back_secs = if at == 1 { 0.0 } else { before.back_secs + self.problem.secs(goal, previous) };
            self.sums[at] = PrefixSums {
                secs,
                weight: before.weight + weight,
                cost: before.cost + weight * secs,
                back_secs,
                back_cost: before.back_cost + weight * back_secs,
            };
            self.position[goal] = at;
        }
    }

    fn reopen(&mut self, position: usize) {
        if let Some(&goal) = self.goals.get(position)
            && !self.is_open[goal]
        {
            self.is_open[goal] = true;
            self.open.push(goal);
        }
    }

    /// The cost of the walk if these stretches replace positions `from` to `to`.
    #[inline]
    fn cost_of(&self, from: usize, to: usize, stretches: &[Stretch]) -> f64 {
        let begin = self.sums[from - 1];
        let (mut at, mut secs, mut cost) = (self.goals[from - 1], begin.secs, begin.cost);
        let end = Stretch { first: to + 1, last: self.problem.count, back: false };
        let rest = (to < self.problem.count).then_some(end);
        for stretch in stretches.iter().chain(&rest) {
            let (first, last, before) =
                (self.sums[stretch.first], self.sums[stretch.last], self.sums[stretch.first - 1]);
            let weight = last.weight - before.weight;
            if stretch.back {
                secs += self.problem.secs(at, self.goals[stretch.last]);
                cost += weight * (secs + last.back_secs) - (last.back_cost - before.back_cost);
                secs += last.back_secs - first.back_secs;
                at = self.goals[stretch.first];
            } else {
                secs += self.problem.secs(at, self.goals[stretch.first]);
                cost += weight * (secs - first.secs) + (last.cost - before.cost);
                secs += last.secs - first.secs;
                at = self.goals[stretch.last];
            }
        }
        cost
    }

    fn apply(&mut self, from: usize, to: usize, stretches: &[Stretch]) {
        let mut spare = std::mem::take(&mut self.spare);
        spare.clear();
        self.reopen(from - 1);
        self.reopen(to + 1);
        for stretch in stretches {
            self.reopen(stretch.first);
            self.reopen(stretch.last);
            let goals = &self.goals[stretch.first..=stretch.last];
            if stretch.back {
                spare.extend(goals.iter().rev());
            } else {
                spare.extend(goals);
            }
        }
        self.goals[from..=to].copy_from_slice(&spare);
        self.spare = spare;
        self.sum_from(from);
    }

    /// Exchanges two neighbouring stretches, at any cost: positions `from` to `middle`, and behind it to `to`.
    pub(super) fn exchange(&mut self, from: usize, middle: usize, to: usize) {
        let first = Stretch { first: from, last: middle, back: false };
        let second = Stretch { first: middle + 1, last: to, back: false };
        self.apply(from, to, &[second, first]);
    }

    /// Applies changes that lower the cost until there is none at any goal whose surroundings have changed, or until
    /// stopped.
    pub(super) fn improve(&mut self, mut until: impl FnMut() -> bool) {
        let mut examined = 0_u32;
        while let Some(goal) = self.open.pop() {
            self.is_open[goal] = false;
            while self.improve_behind(self.position[goal]) {}
            examined = examined.wrapping_add(1);
            if examined.is_multiple_of(64) && until() {
                return;
            }
        }
    }

    /// Finds the best change that gives the goal at a position another successor, or moves the one after it to the end.
    fn improve_behind(&mut self, at: usize) -> bool {
        let count = self.problem.count;
        let from = at + 1;
        if from > count {
            return false;
        }
        let mut best =
            Change { cost: self.cost() * (1.0 - GAIN_MIN), from: 0, to: 0, stretches: [Stretch::NONE; 3], used: 0 };
        let near = self.near;
        for &goal in near.of(self.goals[at]).iter().take(self.reach) {
            let to = self.position[goal as usize];
            if to == from || to == 0 {
                continue;
            }
            if to > from {
                self.weigh(&mut best, from, to, &[Stretch::backwards(from, to)]);
                // The two stretches exchange places.
                if to > from + 1 {
                    let middle = Stretch::forwards(from + 1, to - 1);
                    let (here, there) = (Stretch::forwards(from, from), Stretch::forwards(to, to));
                    self.weigh(&mut best, from, to, &[there, middle, here]);
                }
                for length in 1..=MOVED_MAX {
                    let last = to + length - 1;
                    if last <= count {
                        let passed = Stretch::forwards(from, to - 1);
                        self.weigh(&mut best, from, last, &[Stretch::forwards(to, last), passed]);
                    }
                    if length > 1 && to + 1 > from + length {
                        let first = to + 1 - length;
                        let passed = Stretch::forwards(from, first - 1);
                        self.weigh(&mut best, from, to, &[Stretch::backwards(first, to), passed]);
                    }
                }
            } else {
                // Moves a stretch from before this position to behind it.
                for length in 1..=MOVED_MAX {
                    let last = to + length - 1;
                    if last < at {
                        let passed = Stretch::forwards(last + 1, at);
                        self.weigh(&mut best, to, at, &[passed, Stretch::forwards(to, last)]);
                    }
                    if length > 1 && to >= length && to < at {
                        let first = to + 1 - length;
                        let passed = Stretch::forwards(to + 1, at);
                        self.weigh(&mut best, first, at, &[passed, Stretch::backwards(first, to)]);
                    }
                }
            }
        }
        if from < count {
            let rest = Stretch::forwards(from + 1, count);
            self.weigh(&mut best, from, count, &[rest, Stretch::forwards(from, from)]);
            self.weigh(&mut best, from, count, &[Stretch::backwards(from, count)]);
        }
        if best.used == 0 {
            return false;
        }
        self.apply(best.from, best.to, &best.stretches[..best.used]);
        true
    }

    #[inline]
    fn weigh(&self, best: &mut Change, from: usize, to: usize, stretches: &[Stretch]) {
        let cost = self.cost_of(from, to, stretches);
        if cost < best.cost {
            (best.cost, best.from, best.to, best.used) = (cost, from, to, stretches.len());
            best.stretches[..stretches.len()].copy_from_slice(stretches);
        }
    }
}

impl Stretch {
    const NONE: Stretch = Stretch { first: 0, last: 0, back: false };

    fn forwards(first: usize, last: usize) -> Stretch {
        Stretch { first, last, back: false }
    }

    fn backwards(first: usize, last: usize) -> Stretch {
        Stretch { first, last, back: true }
    }
}

/// The best change found: positions `from` to `to` become these stretches.
struct Change {
    cost: f64,
    from: usize,
    to: usize,
    stretches: [Stretch; 3],
    used: usize,
}
