//! The best simple path from a node at a time: a label-setting search with one label per path to a node.
//!
//! Labels are extended in the order of their lower bounds, until these exceed the cost of the known path. A label is
//! dropped for another at the same node and time that costs no more, if everything that may follow the first may follow
//! the other: no node that only the other has passed can still be reached within the cost of the known path. With tight
//! bounds this nearly always holds, and a city has few labels. Invariant: [`Marks`] reports everything that is pruned
//! otherwise.

use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashMap},
};

use super::{Forecasts, PlanRouteError, bounds::ToGo, cost::Cost, forecast_cache::ForecastCache, network::Network};

/// A path as indices of edges, with its cost.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct EdgePath {
    pub edges: Vec<usize>,
    pub cost: Cost,
}

/// The start of a search, and the nodes and edges that it must avoid.
pub(super) struct Task<'a> {
    /// The path so far.
    pub before: &'a [usize],
    /// The node at the end of the path.
    pub node: usize,
    /// The arrival at the node, in seconds after the reference time.
    pub at_secs: f64,
    /// The cost so far.
    pub cost: Cost,
    /// By node: whether the path has already passed it.
    pub is_passed: &'a [bool],
    /// Edges that must not come next.
    pub closed_first: &'a [usize],
    pub goal: usize,
    /// The latest arrival.
    pub latest_secs: f64,
    /// Paths that arrive within this many seconds, or within the resolution, count as arriving together.
    pub join_secs: f64,
}

/// The prunings without proof, and the reasons for finding no path.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Marks {
    /// Labels of different times at one node were merged.
    pub joined: bool,
    /// No labels were left.
    pub cut_off: bool,
    /// The caller stopped the search.
    pub stopped: bool,
    /// A path took too long.
    pub too_long: bool,
    /// The latest arrival at a node in the search for a good path.
    pub latest_secs: f64,
}

/// A path to a node.
#[derive(Clone, Copy, Debug)]
struct Label {
    node: u32,
    /// The last edge; the first label has none.
    edge: u32,
    /// The label before this one; the first label is its own parent.
    parent: u32,
    /// The next label at the same node and time.
    next: u32,
    at_secs: f64,
    cost: Cost,
    /// The least cost from here of returning to an earlier node and going from there to the goal.
    back: Cost,
    is_dropped: bool,
}

const NONE: u32 = u32::MAX;

/// A search over one map with one set of bounds.
pub(super) struct Labels<'a, 'b, F, U> {
    pub network: &'a Network<'a>,
    pub cache: &'b mut ForecastCache<'a, F>,
    pub to_go: &'b ToGo,
    pub until: &'b mut U,
    /// Number of labels left.
    pub left: &'b mut usize,
    pub marks: &'b mut Marks,
    /// Number of created labels.
    pub made: &'b mut usize,
    labels: Vec<Label>,
    /// By node: passed by the current label if it holds the current stamp.
    stamps: Vec<u32>,
    stamp: u32,
}

impl<'a, 'b, F: Forecasts, U: FnMut() -> bool> Labels<'a, 'b, F, U> {
    pub(super) fn new(
        network: &'a Network<'a>,
        cache: &'b mut ForecastCache<'a, F>,
        to_go: &'b ToGo,
        until: &'b mut U,
        (left, made): (&'b mut usize, &'b mut usize),
        marks: &'b mut Marks,
    ) -> Self {
        let stamps = vec![0; network.nodes.len()];
        Labels { network, cache, to_go, until, left, marks, made, labels: Vec::new(), stamps, stamp: 0 }
    }

    /// Finds a good path: keeps only the first path to each node in the order of lower bounds. `None` if there is none
    /// within `limit`.
    pub(super) fn good(&mut self, task: &Task, limit: Cost) -> Result<Option<EdgePath>, PlanRouteError> {
        self.begin(task);
        let mut is_done = task.is_passed.to_vec();
        let mut best = vec![Cost::INFINITE; self.network.nodes.len()];
        let mut open = BinaryHeap::from([Reverse((task.cost, 0_u32))]);
        while let Some(Reverse((_, at))) = open.pop() {
            let label = self.labels[at as usize];
            let node = label.node as usize;
            if node == task.goal {
                return Ok(Some(EdgePath { edges: self.way(task, at), cost: label.cost }));
            }
            if std::mem::replace(&mut is_done[node], true) {
                continue;
            }
            if at % 256 == 0 && (self.until)() {
                self.marks.stopped = true;
                return Ok(None);
            }
            for edge in self.network.leaving(node) {
                let to = self.network.to(edge);
                if is_done[to] || (at == 0 && task.closed_first.contains(&edge)) {
                    continue;
                }
                let Some((least, found)) = self.extended(task, at, edge, limit)? else { continue };
                if found.cost < best[to] {
                    self.marks.latest_secs = self.marks.latest_secs.max(found.at_secs);
                    best[to] = found.cost;
                    open.push(Reverse((least, self.labels.len() as u32)));
                    self.labels.push(found);
                }
            }
        }
        Ok(None)
    }

    /// The best path that costs less than `limit` and than `known`; otherwise `known`.
    pub(super) fn best(
        &mut self,
        task: &Task,
        known: Option<EdgePath>,
        limit: Cost,
    ) -> Result<Option<EdgePath>, PlanRouteError> {
        self.begin(task);
        let mut limit = known.as_ref().map_or(limit, |known| known.cost.min(limit));
        let mut found = known;
        let mut head_labels: HashMap<(u32, u64), u32> = HashMap::new();
        let mut open_edges = Vec::new();
        let mut open = BinaryHeap::from([Reverse((task.cost, 0_u32))]);
        while let Some(Reverse((least, at))) = open.pop() {
            if least.is_beyond(limit) {
                break;
            }
            let Label { node, is_dropped, .. } = self.labels[at as usize];
            if is_dropped {
                continue;
            }
            if at % 256 == 0 && (self.until)() {
                self.marks.stopped = true;
                break;
            }
            self.mark(at);
            let network = self.network;
            let is_open = |edge: &usize| {
                let to = network.to(*edge);
                let is_passed = task.is_passed[to] || self.stamps[to] == self.stamp;
                !(is_passed || at == 0 && task.closed_first.contains(edge))
            };
            open_edges.clear();
            open_edges.extend(network.leaving(node as usize).filter(is_open));
            for &edge in &open_edges {
                let to = network.to(edge);
                let Some((least, mut label)) = self.extended(task, at, edge, limit)? else { continue };
                if to == task.goal {
                    if label.cost < limit {
                        limit = label.cost;
                        let mut edges = self.way(task, at);
                        edges.push(edge);
                        found = Some(EdgePath { edges, cost: label.cost });
                    }
                    continue;
                }
                let place = (to as u32, self.cache.joined(label.at_secs, task.join_secs).to_bits());
                let head = head_labels.get(&place).copied().unwrap_or(NONE);
                if self.is_dominated(head, &label, at, limit) {
                    continue;
                }
                if *self.left == 0 {
                    self.marks.cut_off = true;
                    return Ok(found);
                }
                *self.left -= 1;
                *self.made += 1;
                label.next = head;
                let index = self.labels.len() as u32;
                head_labels.insert(place, index);
                self.labels.push(label);
                open.push(Reverse((least, index)));
            }
        }
        Ok(found)
    }

    fn begin(&mut self, task: &Task) {
        self.labels.clear();
        self.labels.push(Label {
            node: task.node as u32,
            edge: NONE,
            parent: 0,
            next: NONE,
            at_secs: task.at_secs,
            cost: task.cost,
            back: Cost::INFINITE,
            is_dropped: false,
        });
    }

    /// A label extended by an edge, with its lower bound; `None` if it is useless.
    fn extended(
        &mut self,
        task: &Task,
        at: u32,
        edge: usize,
        limit: Cost,
    ) -> Result<Option<(Cost, Label)>, PlanRouteError> {
        let label = self.labels[at as usize];
        let to = self.network.to(edge);
        let to_go = self.to_go.least[to];
        // This check comes before the edge is forecast.
        if to_go.first.is_infinite() || label.cost.plus(to_go).is_beyond(limit) {
            return Ok(None);
        }
        let Some(traversal) = self.cache.at(edge, label.at_secs)? else { return Ok(None) };
        let at_secs = label.at_secs + traversal.duration_secs;
        let cost = label.cost.plus(traversal.cost);
        let least = cost.plus(to_go);
        if least.is_beyond(limit) {
            return Ok(None);
        }
        if at_secs > task.latest_secs {
            self.marks.too_long = true;
            return Ok(None);
        }
        let back = label.back.least(self.to_go.through(label.node as usize));
        let (node, edge) = (to as u32, edge as u32);
        let made = Label { node, edge, parent: at, next: NONE, at_secs, cost, back, is_dropped: false };
        Ok(Some((least, made)))
    }

    /// Whether a label with the given parent is dominated by those from `head` on; removes those that it dominates.
    fn is_dominated(&mut self, head: u32, label: &Label, parent: u32, limit: Cost) -> bool {
        let mut other = head;
        while other != NONE {
            let Label { next, cost, at_secs, is_dropped, .. } = self.labels[other as usize];
            if !is_dropped {
                if cost <= label.cost {
                    let before = self.labels[other as usize];
                    if self.replaces((&before, before.parent), (label, parent), limit) {
                        self.marks.joined |= at_secs != label.at_secs;
                        return true;
                    }
                } else {
                    let before = self.labels[other as usize];
                    if self.replaces((label, parent), (&before, before.parent), limit) {
                        self.marks.joined |= at_secs != label.at_secs;
                        self.labels[other as usize].is_dropped = true;
                    }
                }
            }
            other = next;
        }
        false
    }

    /// Whether everything that may follow `worse` may follow `better`. Each is given with the index of its parent.
    fn replaces(&mut self, better: (&Label, u32), worse: (&Label, u32), limit: Cost) -> bool {
        let cost = worse.0.cost;
        let is_within = |to_pay: Cost| !cost.plus(to_pay).is_beyond(limit);
        if !is_within(better.0.back) {
            return true;
        }
        self.mark(worse.1);
        let mut at = better.1;
        loop {
            let Label { node, parent, .. } = self.labels[at as usize];
            if self.stamps[node as usize] != self.stamp && is_within(self.to_go.through(node as usize)) {
                return false;
            }
            if parent == at {
                return true;
            }
            at = parent;
        }
    }

    /// Stamps all nodes on the path of a label.
    fn mark(&mut self, mut at: u32) {
        self.stamp += 1;
        loop {
            let Label { node, parent, .. } = self.labels[at as usize];
            self.stamps[node as usize] = self.stamp;
            if parent == at {
                return;
            }
            at = parent;
        }
    }

    fn way(&self, task: &Task, mut at: u32) -> Vec<usize> {
        let mut edges = Vec::new();
        while at != 0 {
            edges.push(self.labels[at as usize].edge as usize);
            at = self.labels[at as usize].parent;
        }
        edges.reverse();
        [task.before, &edges].concat()
    }
}
