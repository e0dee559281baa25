//! The stored form of an ensemble of numbers.
//!
//! Invariant: a round trip gives the same ensemble; parts of a wrong length or out of range are refused.

use super::{NumberEnsemble, RECALL_DAYS, UNSEEN, ahead::CLASSES};
use crate::{InvalidParts, LocalDay};

/// The parts of a [`NumberEnsemble`], for storage. Every list has a fixed length, except the lists of days.
#[derive(Clone, Debug, PartialEq)]
pub struct NumberEnsembleParts {
    /// The last learned day.
    pub last_day: Option<LocalDay>,
    /// All numbers, in this order:
    /// - the origin;
    /// - number, mean and squared deviations of all half-hour bins;
    /// - 11 losses and the number of bins of these losses;
    /// - by hour 24 sums and 24 numbers, for each weekday from Monday, then for weekdays and for the weekend in each of
    ///   three tables;
    /// - for each of two stacks 121 sums of squares, 11 of products, 11 weights;
    /// - by hour of weekdays, then of the weekend: sum of squares and number of errors;
    /// - for each of five lead-time classes: 49 sums of squares, 7 of products, 7 weights, 3 losses and the number of
    ///   bins of these losses, sum of squares and number of errors, two times four means of tables;
    /// - for each of 14 days, at its number modulo 14, 48 values.
    pub numbers: Vec<f64>,
    /// One number for each of the 14 days: a bit for each half-hour, set if it has a reading.
    pub seen: Vec<u64>,
    /// The days of the last turns of each lead-time class, the newer first; at most two.
    pub kept_days: Vec<Vec<LocalDay>>,
}

/// Whether a number may be below 0.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sign {
    Any,
    NotNegative,
}

impl NumberEnsemble {
    /// All numbers in the order in which they are stored.
    fn numbers_mut(&mut self) -> Vec<(Sign, &mut [f64])> {
        use Sign::{Any, NotNegative};
        let mut lists: Vec<(Sign, &mut [f64])> = vec![
            (Any, std::slice::from_mut(&mut self.origin)),
            (NotNegative, std::slice::from_mut(&mut self.scatter.bins)),
            (Any, std::slice::from_mut(&mut self.scatter.mean)),
            (NotNegative, std::slice::from_mut(&mut self.scatter.squares)),
            (NotNegative, &mut self.pool.losses),
            (NotNegative, std::slice::from_mut(&mut self.pool.bins)),
        ];
        for cells in self.tables.week.iter_mut().chain(self.tables.recent.as_flattened_mut()) {
            lists.extend([(Any, &mut cells.sums[..]), (NotNegative, &mut cells.bins[..])]);
        }
        for stack in &mut self.stacks {
            let squares = stack.squares.as_flattened_mut();
            lists.extend([(Any, squares), (Any, &mut stack.products[..]), (Any, &mut stack.weights[..])]);
        }
        lists.push((NotNegative, self.spread.hours.as_flattened_mut().as_flattened_mut()));
        for class in &mut self.ahead.classes {
            let stack = &mut class.stack;
            let squares = stack.squares.as_flattened_mut();
            lists.extend([(Any, squares), (Any, &mut stack.products[..]), (Any, &mut stack.weights[..])]);
            lists.extend([(NotNegative, &mut class.pool.losses[..])]);
            lists.push((NotNegative, std::slice::from_mut(&mut class.pool.bins)));
            lists.extend([(NotNegative, &mut class.errors[..]), (Any, class.kept.as_flattened_mut())]);
        }
        lists.extend(self.recall.iter_mut().map(|day| (Any, &mut day.values[..])));
        lists
    }

    /// The parts to store.
    pub fn to_parts(&self) -> NumberEnsembleParts {
        let days = |class: &super::ahead::FarStack| class.kept_days.iter().flatten().copied().collect();
        let numbers = self.clone().numbers_mut().into_iter().flat_map(|(_, list)| list.to_vec()).collect();
        NumberEnsembleParts {
            last_day: self.last,
            numbers,
            seen: self.recall.iter().map(|day| day.seen).collect(),
            kept_days: self.ahead.classes.iter().map(days).collect(),
        }
    }

    /// An ensemble from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a list has a wrong length or a number is outside its range.
    pub fn from_parts(parts: &NumberEnsembleParts) -> Result<NumberEnsemble, InvalidParts> {
        const FIELD: &str = "number of an ensemble";
        let wrong =
            |found: usize| InvalidParts::OutOfRange { field: "length of a list of an ensemble", found: found as f64 };
        let mut ensemble = NumberEnsemble { last: parts.last_day, ..NumberEnsemble::default() };
        let mut rest = parts.numbers.as_slice();
        for (sign, list) in ensemble.numbers_mut() {
            let (first, others) = rest.split_at_checked(list.len()).ok_or_else(|| wrong(parts.numbers.len()))?;
            let least = if sign == Sign::Any { f64::MIN } else { 0.0 };
            first.iter().try_for_each(|&number| InvalidParts::check(FIELD, number, least..=f64::MAX))?;
            list.copy_from_slice(first);
            rest = others;
        }
        if !rest.is_empty() || parts.seen.len() != RECALL_DAYS || parts.kept_days.len() != CLASSES {
            return Err(wrong(rest.len()));
        }
        for (day, &seen) in ensemble.recall.iter_mut().zip(&parts.seen) {
            day.seen = seen;
        }
        if ensemble.last.is_none() && ensemble.recall != [UNSEEN; RECALL_DAYS] {
            return Err(InvalidParts::OutOfRange { field: "bins of an ensemble without a day", found: 0.0 });
        }
        for (class, days) in ensemble.ahead.classes.iter_mut().zip(&parts.kept_days) {
            if days.len() > class.kept_days.len() || !days.is_sorted_by(|newer, older| newer > older) {
                return Err(wrong(days.len()));
            }
            class.kept_days.iter_mut().zip(days).for_each(|(kept, day)| *kept = Some(*day));
        }
        Ok(ensemble)
    }
}
