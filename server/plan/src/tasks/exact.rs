//! The best plan of few tasks, over all sets of tasks and last tasks.
//!
//! A label is a partial plan: the set of completed tasks, the last of them, its end, and the total worth. A label is
//! dropped if it ends no earlier and is worth no more than another label with the same set and last task, because the
//! other may wait. A label is also dropped if all remaining tasks cannot lift it to the value of a known plan.
//!
//! Invariant: no plan is worth more than the result, up to rounding.

use tidemap_model::StopSignal;

use super::{
    TaskPlanError,
    timing::{Choice, Moves, Timing},
};

/// Maximum number of labels.
const LABELS_MAX: usize = 400_000;
/// Plans whose values differ by less are equal.
pub(super) const VALUE_TIE: f64 = 1e-9;

struct Label {
    value: f64,
    end_secs: f64,
    place: usize,
    /// Index of the previous label, the task and its choice; the first label has none.
    last: Option<(usize, usize, Choice)>,
}

/// The best plan of the tasks. `known`: the value of a known plan. `None`: the search would take too many steps.
pub(super) fn plan_exactly(
    timing: &mut Timing<'_>,
    tasks: &[usize],
    known: f64,
    stop: StopSignal<'_>,
) -> Result<Option<Moves>, TaskPlanError> {
    let count = tasks.len();
    let (start, ready_secs) = (timing.day.start, timing.day.ready_secs);
    let mut labels = vec![Label { value: 0.0, end_secs: ready_secs, place: start, last: None }];
    // The fronts, by set of tasks and then by last task.
    let mut fronts: Vec<Vec<usize>> = vec![Vec::new(); count << count];
    let mut best = 0;
    for set in 0..1_usize << count {
        stop.check()?;
        let left: Vec<usize> = (0..count).filter(|bit| set & (1 << bit) == 0).collect();
        let greatest_worth = |bit: &usize| timing.greatest[tasks[*bit]].0 * timing.greatest[tasks[*bit]].1;
        let possible: f64 = left.iter().map(greatest_worth).sum();
        let first = if set == 0 { vec![0] } else { Vec::new() };
        let of_set = (0..count).flat_map(|last| std::mem::take(&mut fronts[set * count + last]));
        let of_set: Vec<usize> = first.into_iter().chain(of_set).collect();
        for label in of_set {
            let Label { value, end_secs, place, .. } = labels[label];
            let before = &labels[best];
            let is_earlier = value > before.value - VALUE_TIE && end_secs < before.end_secs;
            if value > before.value + VALUE_TIE || is_earlier {
                best = label;
            }
            if value + possible < known - VALUE_TIE {
                continue;
            }
            for &bit in &left {
                let front = &mut fronts[(set | (1 << bit)) * count + bit];
                for choice in timing.choices(place, tasks[bit], end_secs) {
                    let new = Label {
                        value: value + choice.worth,
                        end_secs: choice.end_secs,
                        place: timing.day.tasks[tasks[bit]].place,
                        last: Some((label, tasks[bit], choice)),
                    };
                    add(front, &mut labels, new);
                }
            }
            if labels.len() > LABELS_MAX {
                return Ok(None);
            }
        }
    }
    Ok(Some(moves(&labels, best)))
}

/// Adds a label to a front unless another label is at least as good, and drops the labels that are no better.
fn add(front: &mut Vec<usize>, labels: &mut Vec<Label>, new: Label) {
    let is_no_worse = |one: &Label, other: &Label| one.value >= other.value && one.end_secs <= other.end_secs;
    if front.iter().any(|known| is_no_worse(&labels[*known], &new)) {
        return;
    }
    front.retain(|known| !is_no_worse(&new, &labels[*known]));
    front.push(labels.len());
    labels.push(new);
}

fn moves(labels: &[Label], mut at: usize) -> Moves {
    let value = labels[at].value;
    let mut chosen = Vec::new();
    while let Some((before, task, choice)) = labels[at].last {
        chosen.push((task, choice));
        at = before;
    }
    chosen.reverse();
    Moves { value, chosen }
}
