//! The best order, proven: dynamic programming over sets, with bounds.
//!
//! A walk costs the time of each leg times the weight still unvisited. So of two walks that have visited the same goals
//! and end at the same goal, only the cheaper one matters. A pair of set and goal matters only if its cost plus the
//! bound of the rest is below the cost of a known walk. A goal with an unvisited goal on the way to it is never next,
//! so that a tree or a street has few states. Bounds come in steps: first by the machine alone; if more than 4,000
//! states are left, by paths with few units of weight, then with many. Up to 11 goals a plain table of all sets is
//! faster. Sets are processed by size, so that the search can stop at any time: the least cost plus bound of the last
//! size is then a lower bound.

use super::{
    machine::Machine,
    paths::Paths,
    problem::{Goals, Passing, SearchProblem},
};

/// Relative improvement below which walks are not searched for.
const SAME: f64 = 1e-11;
/// Searches of at most this many goals use plain tables.
pub(super) const TABLE_GOALS_MAX: usize = 11;
/// Maximum number of states with the bound by the machine alone.
const FIRST_STATES: usize = 4_000;
/// Then the bound by paths: rounds of its rewards, units at first and at last, and maximum number of states.
const PATHS: [(usize, u32, u32, usize); 3] =
    [(16, 128, 512, 20_000), (50, 384, 3_072, 200_000), (80, 512, 6_144, usize::MAX)];

/// The result of an exact search.
#[derive(Clone, Debug)]
pub(super) struct Proof {
    /// An order that is better than the one known before the search.
    pub order: Option<Vec<usize>>,
    /// Lower bound of the cost.
    pub lower_bound: f64,
    /// Whether the search is complete.
    pub complete: bool,
    /// Number of visited states.
    pub states: usize,
}

/// A search problem with its goals in the order of its machine.
#[derive(Clone, Copy)]
pub(super) struct SortedProblem<'a> {
    pub problem: &'a SearchProblem,
    pub passing: &'a Passing,
    pub machine: &'a Machine,
}

impl SortedProblem<'_> {
    /// Searches for an order that costs less than a known one, within a small number of states.
    pub(crate) fn prove_quickly(self, known: f64, states_max: usize, until: impl FnMut() -> bool) -> Proof {
        if self.problem.count <= TABLE_GOALS_MAX {
            return table(self, known);
        }
        let mut proven = Layers { search: self, paths: None, known }.search(states_max.min(FIRST_STATES), until);
        proven.lower_bound = proven.lower_bound.max(self.machine.root).min(known);
        proven
    }

    /// Searches for an order that costs less than a known one, with more expensive bounds. `states_max` includes the
    /// states of `before`.
    pub(super) fn prove(self, known: f64, before: &Proof, states_max: usize, mut until: impl FnMut() -> bool) -> Proof {
        let (mut lower_bound, mut states) = (before.lower_bound, before.states);
        let mut paths = Paths::new(self.problem, self.passing, PATHS[0].1);
        for (rounds, units, last_units, max_states) in PATHS {
            if states >= states_max || until() {
                break;
            }
            paths.set_units(self.problem, self.passing, units);
            paths.improve(rounds, known, &mut until);
            paths.set_units(self.problem, self.passing, last_units);
            paths.improve(1, known, &mut until);
            lower_bound = lower_bound.max(paths.root);
            let layers = Layers { search: self, paths: Some(&paths), known };
            let mut proven = layers.search(max_states.min(states_max - states), &mut until);
            states += proven.states;
            lower_bound = lower_bound.max(proven.lower_bound).min(known);
            if proven.complete {
                proven.states = states;
                return proven;
            }
        }
        Proof { order: None, lower_bound: lower_bound.min(known), complete: false, states }
    }
}

/// Bounds, by the machine, of the rest of a walk after each goal of a set; yields them with the goal.
struct RestBounds<'a> {
    problem: &'a SearchProblem,
    machine: &'a Machine,
    weight: f64,
    /// Bound of the set's goals by the machine, and its duration up to each.
    cost: f64,
    left: Goals,
    secs: f64,
    weight_behind: f64,
}

impl<'a> RestBounds<'a> {
    fn new(problem: &'a SearchProblem, machine: &'a Machine, goals: Goals) -> RestBounds<'a> {
        let (mut weight, mut cost, mut secs, mut rest) = (0.0, 0.0, 0.0, goals);
        while rest != 0 {
            let goal = rest.trailing_zeros() as usize;
            weight += problem.weight[goal];
            cost += problem.weight[goal] * (secs + machine.arriving[goal]);
            secs += machine.arriving[goal] + machine.leaving[goal];
            rest &= rest - 1;
        }
        RestBounds { problem, machine, weight, cost, left: goals, secs: 0.0, weight_behind: weight }
    }
}

impl Iterator for RestBounds<'_> {
    type Item = (usize, f64);

    #[inline]
    fn next(&mut self) -> Option<(usize, f64)> {
        if self.left == 0 {
            return None;
        }
        let goal = self.left.trailing_zeros() as usize;
        self.left &= self.left - 1;
        let weight = self.problem.weight[goal];
        let (arriving, leaving) = (self.machine.arriving[goal], self.machine.leaving[goal]);
        self.weight_behind -= weight;
        let others = self.cost - weight * (self.secs + arriving) - (arriving + leaving) * self.weight_behind;
        self.secs += arriving + leaving;
        Some((goal, others + leaving * (self.weight - weight)))
    }
}

/// The search for few goals: a table of all sets.
fn table(SortedProblem { problem, passing, machine }: SortedProblem<'_>, known: f64) -> Proof {
    let count = problem.count;
    let sets = 1_usize << count;
    let limit = known * (1.0 - SAME);
    let mut costs = vec![f64::INFINITY; sets * count];
    // The goals at which a walk may end that has visited this set, and their predecessors.
    let mut ends = vec![0_u16; sets];
    let mut before = vec![0_u8; sets * count];
    let mut bounds = [0.0; TABLE_GOALS_MAX];
    let mut states = 0;
    for set in 0..sets - 1 {
        if set > 0 && ends[set] == 0 {
            continue;
        }
        let left = ((sets - 1) & !set) as Goals;
        let after = RestBounds::new(problem, machine, left);
        let weight = after.weight;
        after.for_each(|(goal, bound)| bounds[goal] = bound);
        let mut here = if set == 0 { 1 << count } else { u32::from(ends[set]) };
        while here != 0 {
            let at = here.trailing_zeros() as usize;
            here &= here - 1;
            states += 1;
            let cost = if at == count { 0.0 } else { costs[set * count + at] };
            let row = problem.row(at);
            let mut rest = left;
            while rest != 0 {
                let to = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let then = cost + row[to] * weight;
                if then + bounds[to] < limit && passing.between(at, to) & left == 0 {
                    let (with, place) = (set | 1 << to, (set | 1 << to) * count + to);
                    if then < costs[place] {
                        costs[place] = then;
                        before[place] = at as u8;
                        ends[with] |= 1 << to;
                    }
                }
            }
        }
    }
    let last = &costs[(sets - 1) * count..];
    let best = (0..count).min_by(|&a, &b| last[a].total_cmp(&last[b]));
    let Some(mut at) = best.filter(|&at| last[at] < limit) else {
        return Proof { order: None, lower_bound: known, complete: true, states };
    };
    let lower_bound = last[at];
    let (mut set, mut order) = (sets - 1, Vec::with_capacity(count));
    while at != count {
        order.push(at);
        let previous = usize::from(before[set * count + at]);
        set &= !(1 << at);
        at = previous;
    }
    order.reverse();
    Proof { order: Some(order), lower_bound, complete: true, states }
}

/// A set of visited goals, the current goal, and the cost.
#[derive(Clone, Copy, Debug)]
struct SearchState {
    visited: Goals,
    at: u32,
    cost: f64,
    /// Cost plus bound of the rest.
    bound: f64,
}

/// The search for more goals: only the states that may lead to a better walk, by size of the set.
struct Layers<'a> {
    search: SortedProblem<'a>,
    paths: Option<&'a Paths>,
    known: f64,
}

impl Layers<'_> {
    fn search(&self, states_max: usize, mut until: impl FnMut() -> bool) -> Proof {
        let count = self.search.problem.count;
        let all: Goals = (1 << count) - 1;
        let mut layers = vec![vec![SearchState { visited: 0, at: count as u32, cost: 0.0, bound: 0.0 }]];
        let mut index = StateIndex::default();
        let mut states = 1;
        for _ in 0..count {
            let mut next = Vec::new();
            index.clear();
            let here = &layers[layers.len() - 1];
            for (number, &state) in here.iter().enumerate() {
                if states + next.len() > states_max || number % 256 == 255 && until() {
                    let lower_bound = here.iter().map(|state| state.bound).fold(self.known, f64::min);
                    return Proof { order: None, lower_bound, complete: false, states: states + next.len() };
                }
                self.go_on(state, all, &mut index, &mut next);
            }
            states += next.len();
            layers.push(next);
        }
        let last = layers.last().and_then(|last| last.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)));
        let lower_bound = last.map_or(self.known, |last| last.cost);
        let order = last.map(|&last| self.trace(&layers, last));
        Proof { order, lower_bound, complete: true, states }
    }

    fn go_on(&self, state: SearchState, all: Goals, index: &mut StateIndex, next: &mut Vec<SearchState>) {
        let left = all & !state.visited;
        let limit = self.known * (1.0 - SAME);
        let sums = self.paths.map(|paths| (paths, paths.sums(left)));
        let after = RestBounds::new(self.search.problem, self.search.machine, left);
        let weight = after.weight;
        let row = self.search.problem.row(state.at as usize);
        for (to, machine_bound) in after {
            let cost = state.cost + row[to] * weight;
            if cost + machine_bound >= limit || self.search.passing.between(state.at as usize, to) & left != 0 {
                continue;
            }
            let behind = sums.map_or(machine_bound, |(paths, sums)| machine_bound.max(paths.behind(left, sums, to)));
            let bound = cost + behind;
            if bound >= limit {
                continue;
            }
            let reached = SearchState { visited: state.visited | 1 << to, at: to as u32, cost, bound };
            match index.find_or_insert(next, reached) {
                Some(other) if cost < other.cost => *other = reached,
                _ => {}
            }
        }
    }

    fn trace(&self, layers: &[Vec<SearchState>], last: SearchState) -> Vec<usize> {
        let mut order = vec![last.at as usize];
        let mut state = last;
        for layer in layers[1..layers.len() - 1].iter().rev() {
            let visited = state.visited & !(1 << state.at);
            let came = |from: &&SearchState| {
                from.visited == visited
                    && self.search.passing.between(from.at as usize, state.at as usize) & !visited & !(1 << state.at)
                        == 0
            };
            let weight: f64 = (0..self.search.problem.count)
                .filter(|goal| visited & (1 << goal) == 0)
                .map(|goal| self.search.problem.weight[goal])
                .sum();
            let cost =
                |from: &SearchState| from.cost + self.search.problem.secs(from.at as usize, state.at as usize) * weight;
            let from = layer.iter().filter(came).min_by(|a, b| cost(a).total_cmp(&cost(b)));
            if let Some(&from) = from {
                order.push(from.at as usize);
                state = from;
            }
        }
        order.reverse();
        order
    }
}

/// The position of each state in a layer: an open-addressing hash table.
#[derive(Debug, Default)]
struct StateIndex {
    /// One more than the number of the state; 0: the slot is free. The length is a power of two.
    slots: Vec<u32>,
}

impl StateIndex {
    fn clear(&mut self) {
        self.slots.clear();
        self.slots.resize(1 << 10, 0);
    }

    fn slot(&self, state: &SearchState) -> usize {
        let key = state.visited.wrapping_mul(64).wrapping_add(u64::from(state.at));
        (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & (self.slots.len() - 1)
    }

    /// The state of this set and goal; adds it if there is none.
    fn find_or_insert<'s>(
        &mut self,
        states: &'s mut Vec<SearchState>,
        state: SearchState,
    ) -> Option<&'s mut SearchState> {
        if (states.len() + 1) * 2 > self.slots.len() {
            self.grow(states);
        }
        let mut slot = self.slot(&state);
        loop {
            let number = self.slots[slot] as usize;
            if number == 0 {
                states.push(state);
                self.slots[slot] = states.len() as u32;
                return None;
            }
            if states[number - 1].visited == state.visited && states[number - 1].at == state.at {
                return Some(&mut states[number - 1]);
            }
            slot = (slot + 1) & (self.slots.len() - 1);
        }
    }

    fn grow(&mut self, states: &[SearchState]) {
        let length = self.slots.len() * 4;
        self.slots.clear();
        self.slots.resize(length, 0);
        for (number, state) in states.iter().enumerate() {
            let mut slot = self.slot(state);
            while self.slots[slot] != 0 {
                slot = (slot + 1) & (length - 1);
            }
            self.slots[slot] = number as u32 + 1;
        }
    }
}
