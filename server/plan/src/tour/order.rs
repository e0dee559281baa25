//! The order of a drive through goals: the shortest for few goals, a good one for many.
//!
//! Invariant: the drive is never longer than the nearest-neighbour drive.

use tidemap_model::StopSignal;

/// Maximum number of goals with the shortest drive (Held and Karp 1962).
pub(super) const EXACT_MAX: usize = 12;
/// Smaller differences of drives are rounding, metres.
const SHORTER_M: f64 = 1e-9;

/// Distances from the start to each goal and between goals, metres.
#[derive(Clone, Debug)]
pub(super) struct Ways<'a> {
    from_start: Vec<f64>,
    returns: bool,
    between: Vec<f64>,
    /// If this is set, orders are found early, and must not be used.
    pub(super) stop: StopSignal<'a>,
}

impl<'a> Ways<'a> {
    /// Distances are symmetric: `between` is called with a lower and a higher number.
    pub(super) fn new(
        from_start: Vec<f64>,
        returns: bool,
        stop: StopSignal<'a>,
        between: impl Fn(usize, usize) -> f64,
    ) -> Ways<'a> {
        let count = from_start.len();
        let way = |at: usize| {
            let (one, other) = (at / count, at % count);
            if one == other { 0.0 } else { between(one.min(other), one.max(other)) }
        };
        let between = (0..count * count).map(way).collect();
        Ways { from_start, returns, between, stop }
    }

    /// Number of goals.
    pub(super) fn count(&self) -> usize {
        self.from_start.len()
    }

    fn between(&self, one: usize, other: usize) -> f64 {
        self.between[one * self.count() + other]
    }

    fn to_end(&self, goal: usize) -> f64 {
        if self.returns { self.from_start[goal] } else { 0.0 }
    }

    /// Length of the drive to the last of the goals.
    pub(super) fn to_last(&self, order: &[usize]) -> f64 {
        let first = order.first().map_or(0.0, |&first| self.from_start[first]);
        order.windows(2).fold(first, |length, pair| length + self.between(pair[0], pair[1]))
    }

    /// Length of the drive to its end.
    pub(super) fn length(&self, order: &[usize]) -> f64 {
        self.to_last(order) + order.last().map_or(0.0, |&last| self.to_end(last))
    }

    /// A short drive through goals.
    pub(super) fn order(&self, goals: &[usize]) -> Vec<usize> {
        if goals.len() <= EXACT_MAX { self.shortest(goals) } else { self.improved(self.nearest(goals)) }
    }

    /// The shortest drive, by the shortest drives through all subsets.
    pub(super) fn shortest(&self, goals: &[usize]) -> Vec<usize> {
        let count = goals.len();
        if count == 0 {
            return Vec::new();
        }
        // By subset, then by the last goal: the length, and the goal before the last.
        let mut best = vec![(f64::INFINITY, usize::MAX); count << count];
        for (last, &goal) in goals.iter().enumerate() {
            best[(1 << last) * count + last] = (self.from_start[goal], usize::MAX);
        }
        for subset in 1_usize..1 << count {
            for last in (0..count).filter(|last| subset >> last & 1 == 1) {
                let (length, _) = best[subset * count + last];
                for next in (0..count).filter(|next| subset >> next & 1 == 0) {
                    let longer = length + self.between(goals[last], goals[next]);
                    let known = &mut best[(subset | 1 << next) * count + next];
                    if known.1 == usize::MAX || longer < known.0 {
                        *known = (longer, last);
                    }
                }
            }
        }
        let mut subset = (1_usize << count) - 1;
        let whole = |last: &usize| best[subset * count + last].0 + self.to_end(goals[*last]);
        let last = (0..count).reduce(|one, other| if whole(&other) < whole(&one) { other } else { one });
        let mut order = Vec::with_capacity(count);
        let mut at = last.unwrap_or(0);
        while at != usize::MAX {
            order.push(goals[at]);
            let before = best[subset * count + at].1;
            subset &= !(1 << at);
            at = before;
        }
        order.reverse();
        order
    }

    /// The nearest-neighbour drive.
    pub(super) fn nearest(&self, goals: &[usize]) -> Vec<usize> {
        let mut left = goals.to_vec();
        let mut order: Vec<usize> = Vec::with_capacity(goals.len());
        while !left.is_empty() {
            let way = |goal: usize| order.last().map_or(self.from_start[goal], |&last| self.between(last, goal));
            let nearer = |one: usize, other: usize| if way(left[other]) < way(left[one]) { other } else { one };
            let next = (0..left.len()).reduce(nearer).unwrap_or(0);
            order.push(left.remove(next));
        }
        order
    }

    /// Turns parts of a drive around (Croes 1958), and moves parts of up to three goals elsewhere (Or 1976), until
    /// neither makes it shorter.
    pub(super) fn improved(&self, mut order: Vec<usize>) -> Vec<usize> {
        let mut length = self.length(&order);
        let mut best = order.clone();
        loop {
            let before = length;
            let mut keep = |changed: &[usize], order: &mut Vec<usize>| {
                let new = self.length(changed);
                if new < length - SHORTER_M {
                    length = new;
                    order.clear();
                    order.extend_from_slice(changed);
                }
            };
            for from in (0..order.len()).take_while(|_| !self.stop.is_set()) {
                for to in from + 1..order.len() {
                    best.clone_from(&order);
                    best[from..=to].reverse();
                    keep(&best, &mut order);
                }
            }
            for part in 1..=3 {
                for from in (0..order.len().saturating_sub(part - 1)).take_while(|_| !self.stop.is_set()) {
                    for to in 0..=order.len() - part {
                        for is_turned in [false, true] {
                            best.clone_from(&order);
                            let mut moved: Vec<usize> = best.drain(from..from + part).collect();
                            if is_turned {
                                moved.reverse();
                            }
                            best.splice(to..to, moved);
                            keep(&best, &mut order);
                        }
                    }
                }
            }
            if length >= before || self.stop.is_set() {
                return order;
            }
        }
    }
}
