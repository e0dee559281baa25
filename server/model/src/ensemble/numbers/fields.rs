//! The stored fields of an ensemble of numbers.
//!
//! Invariant: an ensemble that was written is read back as it was; a wrong length or a number out of range is refused.

use std::{ops::RangeInclusive, slice};

use super::{
    NumberEnsemble, RECALL_DAYS, UNSEEN,
    ahead::{CLASSES, FarStack},
};
use crate::fields::{FINITE, NOT_NEGATIVE, StoredFields, Visitor};
use crate::{InvalidParts, LocalDay};

const NUMBER: &str = "number of an ensemble";

/// The days of the last turns of a lead-time class, the newer first.
#[derive(Debug, Default)]
struct Turns(Vec<LocalDay>);

impl StoredFields for Turns {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integers(1, "turns of a lead time", &mut self.0)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        if self.0.len() <= 2 && self.0.is_sorted_by(|newer, older| newer > older) {
            Ok(())
        } else {
            Err(InvalidParts::OutOfRange { field: "turns of a lead time", found: self.0.len() as f64 })
        }
    }
}

impl NumberEnsemble {
    /// All numbers in the order in which they are stored, and their ranges. By hour: 24 sums and 24 numbers of bins,
    /// for each weekday from Monday on, then for weekdays and for the weekend in each of three tables.
    fn numbers(&mut self) -> Vec<(RangeInclusive<f64>, &mut [f64])> {
        let mut lists: Vec<(RangeInclusive<f64>, &mut [f64])> = vec![
            (FINITE, slice::from_mut(&mut self.origin)),
            (NOT_NEGATIVE, slice::from_mut(&mut self.scatter.bins)),
            (FINITE, slice::from_mut(&mut self.scatter.mean)),
            (NOT_NEGATIVE, slice::from_mut(&mut self.scatter.squares)),
            (NOT_NEGATIVE, &mut self.pool.losses),
            (NOT_NEGATIVE, slice::from_mut(&mut self.pool.bins)),
        ];
        for cells in self.tables.week.iter_mut().chain(self.tables.recent.as_flattened_mut()) {
            lists.extend([(FINITE, &mut cells.sums[..]), (NOT_NEGATIVE, &mut cells.bins[..])]);
        }
        for stack in &mut self.stacks {
            let squares = stack.squares.as_flattened_mut();
            lists.extend([(FINITE, squares), (FINITE, &mut stack.products[..]), (FINITE, &mut stack.weights[..])]);
        }
        lists.push((NOT_NEGATIVE, self.spread.hours.as_flattened_mut().as_flattened_mut()));
        for FarStack { stack, pool, errors, kept, .. } in &mut self.ahead.classes {
            let squares = stack.squares.as_flattened_mut();
            lists.extend([(FINITE, squares), (FINITE, &mut stack.products[..]), (FINITE, &mut stack.weights[..])]);
            lists.extend([(NOT_NEGATIVE, &mut pool.losses[..]), (NOT_NEGATIVE, slice::from_mut(&mut pool.bins))]);
            lists.extend([(NOT_NEGATIVE, &mut errors[..]), (FINITE, kept.as_flattened_mut())]);
        }
        lists.extend(self.recall.iter_mut().map(|day| (FINITE, &mut day.values[..])));
        lists
    }
}

impl StoredFields for NumberEnsemble {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "last day of an ensemble", &mut self.last)?;
        let mut numbers: Vec<&mut [f64]> = self.numbers().into_iter().map(|(_, list)| list).collect();
        visitor.lists(2, NUMBER, FINITE, &mut numbers)?;
        let mut seen = self.recall.map(|day| day.seen);
        visitor.list(3, "half-hours with readings", FINITE, &mut seen)?;
        self.recall.iter_mut().zip(seen).for_each(|(day, seen)| day.seen = seen);
        let days = |class: &FarStack| Turns(class.kept_days.iter().flatten().copied().collect());
        let mut turns: [Turns; CLASSES] = self.ahead.classes.each_ref().map(days);
        visitor.messages(4, "turns of the lead times", &mut turns)?;
        for (class, Turns(days)) in self.ahead.classes.iter_mut().zip(turns) {
            class.kept_days = [days.first().copied(), days.get(1).copied()];
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        for (range, list) in self.numbers() {
            list.iter().try_for_each(|&number| InvalidParts::check(NUMBER, number, range.clone()))?;
        }
        if self.last.is_none() && self.recall != [UNSEEN; RECALL_DAYS] {
            return Err(InvalidParts::OutOfRange { field: "bins of an ensemble without a day", found: 0.0 });
        }
        Ok(())
    }
}
