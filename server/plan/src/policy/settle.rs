//! Solves for the values of one slot, which depend on each other and on those of later slots.
//!
//! The value of each choice is a known part, from later slots, plus a share of the value of one other node in the same
//! slot. Every edge takes time, so the share is less than 1: the equations are those of a discounted problem, with one
//! solution. Dijkstra's order of nodes does not solve them, because a later slot may be better than this one, and a
//! node then better than the node to which it leads. So policy iteration is used (R. A. Howard, "Dynamic Programming
//! and Markov Processes", 1960): with one choice for each node, each node depends on one other, and the values follow
//! along chains and around cycles in closed form; then each node takes its best choice. Invariant: the values of a
//! policy are exact up to rounding, and each policy is better than the one before, so the iteration ends.

/// A choice at a node in a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlotChoice {
    /// The known part of the choice's value, by objective part; less is better.
    pub known: [f64; 3],
    /// 1 minus the share of the value of `to` in this slot; above 0, at most 1.
    pub leak: f64,
    pub to: u32,
    /// Index of the edge, or [`WAIT`].
    pub edge: u32,
}

/// Smaller relative improvements are rounding errors.
const ROUNDING: f64 = 1e-14;
/// Usually fewer than ten rounds suffice.
const ROUNDS_MAX: usize = 10_000;

/// Choices of all nodes of a slot.
pub(super) struct SlotChoices {
    /// The choices, node by node.
    pub all: Vec<SlotChoice>,
    /// Start index of each node's choices; one entry more than nodes.
    pub first: Vec<u32>,
}

impl SlotChoices {
    pub(super) fn of(&self, node: usize) -> std::ops::Range<usize> {
        self.first[node] as usize..self.first[node + 1] as usize
    }

    /// The value of a choice in a part.
    pub(super) fn worth(&self, choice: usize, part: usize, values: &[f64]) -> f64 {
        let SlotChoice { known, leak, to, .. } = self.all[choice];
        // A share of 0 of an infinite value counts as 0.
        if leak >= 1.0 { known[part] } else { known[part] + (1.0 - leak) * values[to as usize] }
    }

    /// Excludes the choices of each node that are worse than its value by more than `tie` of it.
    pub(super) fn narrow(&self, part: usize, values: &[f64], tie: impl Fn(f64) -> f64, is_best: &mut [bool]) {
        for (node, &value) in values.iter().enumerate() {
            for choice in self.of(node) {
                is_best[choice] &= self.worth(choice, part, values) <= value + tie(value);
            }
        }
    }

    /// The first choice of each node.
    pub(crate) fn firsts(&self) -> ChoiceByNode {
        (0..self.first.len() - 1).map(|node| self.of(node).next().map(|choice| choice as u32)).collect()
    }
}

/// The choice of each node; `None` without choices.
pub(super) type ChoiceByNode = Vec<Option<u32>>;

/// Finds the least values in a part and their choices, from good initial values; nodes without a choice keep their
/// value. `is_allowed` restricts the choices.
pub(super) fn settle(choices: &SlotChoices, part: usize, values: &mut [f64], is_allowed: &[bool]) -> ChoiceByNode {
    let best = |node: usize, values: &[f64]| {
        let mut best: Option<(f64, u32)> = None;
        for choice in choices.of(node).filter(|&choice| is_allowed[choice]) {
            let worth = choices.worth(choice, part, values);
            if best.is_none_or(|(least, _)| worth < least) {
                best = Some((worth, choice as u32));
            }
        }
        best
    };
    let mut picked: ChoiceByNode = (0..values.len()).map(|node| best(node, values).map(|(_, choice)| choice)).collect();
    for _ in 0..ROUNDS_MAX {
        evaluate(choices, part, &picked, values);
        let mut is_better = false;
        for node in 0..values.len() {
            let Some((worth, choice)) = best(node, values) else { continue };
            if picked[node] != Some(choice) && worth < values[node] - ROUNDING * values[node].abs() {
                picked[node] = Some(choice);
                is_better = true;
            }
        }
        if !is_better {
            break;
        }
    }
    picked
}

/// The values of nodes with one choice each; nodes without a choice keep their value.
pub(super) fn evaluate(choices: &SlotChoices, part: usize, picked: &ChoiceByNode, values: &mut [f64]) {
    #[derive(Clone, Copy, PartialEq)]
    enum Mark {
        New,
        OnChain,
        Done,
    }
    let mut marks: Vec<Mark> =
        picked.iter().map(|choice| if choice.is_some() { Mark::New } else { Mark::Done }).collect();
    let mut chain: Vec<(usize, SlotChoice)> = Vec::new();
    for start in 0..values.len() {
        let mut node = start;
        chain.clear();
        while let (Mark::New, Some(choice)) = (marks[node], picked[node]) {
            let choice = choices.all[choice as usize];
            marks[node] = Mark::OnChain;
            chain.push((node, choice));
            if choice.leak >= 1.0 {
                break;
            }
            node = choice.to as usize;
        }
        let is_cycle = chain.last().is_some_and(|last| last.1.leak < 1.0) && marks[node] == Mark::OnChain;
        if is_cycle {
            let from = chain.iter().position(|&(other, _)| other == node).unwrap_or(0);
            // x = known + share · x around the cycle.
            let (mut known, mut log_share) = (0.0, 0.0_f64);
            for (_, choice) in &chain[from..] {
                known += log_share.exp() * choice.known[part];
                log_share += (-choice.leak).ln_1p();
            }
            values[node] = known / -log_share.exp_m1();
            marks[node] = Mark::Done;
        }
        for &(node, choice) in chain.iter().rev() {
            if marks[node] == Mark::OnChain {
                let share = if choice.leak >= 1.0 { 0.0 } else { (1.0 - choice.leak) * values[choice.to as usize] };
                values[node] = choice.known[part] + share;
                marks[node] = Mark::Done;
            }
        }
    }
}
