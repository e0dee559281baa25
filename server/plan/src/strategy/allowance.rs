//! The allowance of an online strategy for a day's visits: each slot is granted or refused when it comes, up to the
//! allowance.
//!
//! Invariant: over a day in which every slot is requested, exactly the allowed number is granted, or all slots.

use std::collections::VecDeque;

use super::StrategyError;

/// Number of past days by which a visit is judged.
const DAYS_KEPT: usize = 7;

/// The visits of a day; every slot is requested in order.
///
/// A slot is granted if fewer later slots of the day are expected to be better than there are visits left. The
/// expectation is each slot's best gain on the last seven days; equal gains count half. Before the first day is over,
/// visits are spread evenly.
#[derive(Clone, Debug)]
pub struct Allowance {
    slots: usize,
    visits: usize,
    spent: usize,
    today: Vec<f64>,
    days: VecDeque<Vec<f64>>,
}

/// Whether a visit now, with this gain, is worth one of the `left` visits of the day: fewer of the later slots are
/// expected to be better. `later`: the best expected gain of each later slot of the day. Equal gains count half; NaN
/// counts as 0.
pub fn is_worth_a_visit(gain: f64, later: &[f64], left: usize) -> bool {
    let of_slot = |other: &f64| better(other.max(0.0), gain.max(0.0));
    left > later.len() || (left > 0 && later.iter().map(of_slot).sum::<f64>() < left as f64)
}

/// Returns 1 if `other` is higher, one half if it is equal.
fn better(other: f64, gain: f64) -> f64 {
    match other.total_cmp(&gain) {
        std::cmp::Ordering::Greater => 1.0,
        std::cmp::Ordering::Equal => 0.5,
        std::cmp::Ordering::Less => 0.0,
    }
}

impl Allowance {
    /// An allowance of `visits` a day, with `slots` a day.
    ///
    /// # Errors
    /// [`StrategyError`] where there are no slots or more visits than slots.
    pub fn new(slots: usize, visits: usize) -> Result<Allowance, StrategyError> {
        if slots == 0 {
            return Err(StrategyError::NoSlots);
        }
        if visits > slots {
            return Err(StrategyError::Budget { visits, slots });
        }
        Ok(Allowance { slots, visits, spent: 0, today: Vec::new(), days: VecDeque::new() })
    }

    /// Whether to use the next slot, whose best visit has this gain. After the last slot of a day comes the first of
    /// the next. A gain that is NaN counts as 0.
    pub fn grant(&mut self, gain: f64) -> bool {
        let gain = gain.max(0.0);
        let slot = self.today.len();
        let (later, left) = (self.slots - slot - 1, self.visits - self.spent);
        let granted = if left == 0 || left > later {
            left > 0
        } else if self.days.is_empty() {
            (slot + 1) * self.visits / self.slots > self.spent
        } else {
            self.better_later(slot, gain) < left as f64
        };
        self.spent += usize::from(granted);
        self.today.push(gain);
        if later == 0 {
            self.days.push_back(std::mem::take(&mut self.today));
            if self.days.len() > DAYS_KEPT {
                self.days.pop_front();
            }
            self.spent = 0;
        }
        granted
    }

    /// The mean number of later slots of a day with a higher gain, over the kept days.
    fn better_later(&self, slot: usize, gain: f64) -> f64 {
        let of_slot = |&other: &f64| better(other, gain);
        let later = |day: &Vec<f64>| day.iter().skip(slot + 1).map(of_slot).sum::<f64>();
        self.days.iter().map(later).sum::<f64>() / self.days.len().max(1) as f64
    }
}
