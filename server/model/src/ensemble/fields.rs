//! The stored fields of an ensemble.
//!
//! Invariant: an ensemble that was written is read back as it was; a wrong length or a number out of range is refused.

use std::{array, slice, sync::OnceLock};

use super::bins::SLOTS;
use super::outlook::{Class, FAR_MEMBERS, StoredForecast};
use super::recall::{DAYS, SeenDay};
use super::recalled::RECALLED;
use super::rotation::LONGEST;
use super::season::{FiveDays, Rhythm};
use super::{Ensemble, Stack, WeekTable, equivalent_bins};
use crate::InvalidParts;
use crate::fields::{FINITE, NOT_NEGATIVE, Packed, StoredFields, Visitor};

const RHYTHM: &str = "rhythm of the year";

fn wrong(field: &'static str, found: usize) -> InvalidParts {
    InvalidParts::OutOfRange { field, found: found as f64 }
}

impl StoredFields for Ensemble {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.lists(
            1,
            "sum and number of bins",
            0.0..=1e15,
            &mut [array::from_mut(&mut self.sum), array::from_mut(&mut self.bins)],
        )?;
        visitor.integer(2, "last day of an ensemble", &mut self.recall.last)?;
        for (tag, table) in [(3, &mut self.all), (4, &mut self.recent)] {
            // By hour of the week from Monday on, then by prior.
            visitor.lists(tag, "week table of an ensemble", FINITE, &mut table.lists())?;
        }
        // By half-hour of weekdays, then of the weekend.
        let alike = [&mut self.alike.sums, &mut self.alike.bins, &mut self.alike.last];
        visitor.lists(5, "days of a kind of an ensemble", FINITE, &mut alike.map(|kinds| kinds.as_flattened_mut()))?;
        visitor.list(6, "bins of the last days", FINITE, &mut self.recall.days)?;
        visitor.list(7, "residuals of an ensemble", FINITE, &mut self.rotation.residuals)?;
        visitor.integer(8, "last day of the residuals", &mut self.rotation.last)?;
        let rotations: &mut [&mut [f32]] = &mut [&mut self.rotation.products, &mut self.rotation.squares];
        visitor.lists(9, "rotations of an ensemble", FINITE, rotations)?;
        visitor.messages(10, "means of five days", &mut self.season.five_days)?;
        visitor.integer(11, "first day of the season", &mut self.season.first)?;
        visitor.integer(12, "last day of the season", &mut self.season.last)?;
        visitor.integers(13, "gaps between observed days", &mut self.season.gaps)?;
        visitor.lists(14, RHYTHM, -1e6..=1e6, &mut self.season.rhythm.lists())?;
        for (tag, stack) in (15..).zip(&mut self.stacks) {
            visitor.lists(tag, "stack of an ensemble", FINITE, &mut stack.lists())?;
        }
        visitor.list(17, "losses of the members", FINITE, &mut self.pool.losses)?;
        visitor.messages(18, "lead-time classes of an ensemble", &mut self.outlook.classes)?;
        let calibration: &mut [&mut [f32]] = &mut [&mut self.calibration.departures, &mut self.calibration.neighbours];
        visitor.lists(19, "calibration of an ensemble", FINITE, calibration)?;
        visitor.list(20, "smooth table", 0.0..=1.0, &mut self.smooth)?;
        visitor.number(21, "bins of the smooth table", 0.0..=1e15, &mut self.smooth_bins)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        InvalidParts::check("sum of bins", self.sum, 0.0..=self.bins * (1.0 + 1e-9))?;
        for table in [&self.all, &self.recent] {
            if table.weights.as_flattened().iter().any(|&weight| weight <= 0.0) {
                return Err(wrong("weights of an ensemble's priors", 0));
            }
        }
        let length = |last: Option<_>, days| if last.is_some() { days } else { 0 };
        if self.recall.days.len() != length(self.recall.last, DAYS) {
            return Err(wrong("number of last days", self.recall.days.len()));
        }
        if self.rotation.residuals.len() != length(self.rotation.last, LONGEST) {
            return Err(wrong("number of days with residuals", self.rotation.residuals.len()));
        }
        if !self.season.five_days.is_sorted_by_key(|days| days.day) {
            return Err(wrong("order of the means of five days", 0));
        }
        self.known = equivalent_bins(&self.all.bins_by_kind());
        self.far = OnceLock::new();
        Ok(())
    }
}

impl WeekTable {
    fn lists(&mut self) -> [&mut [f32]; 3] {
        [self.sums.as_flattened_mut(), self.bins.as_flattened_mut(), self.weights.as_flattened_mut()]
    }
}

impl Stack {
    fn lists(&mut self) -> [&mut [f32]; 3] {
        [&mut self.squares, &mut self.products, &mut self.weights]
    }
}

impl Rhythm {
    /// The mean, then cosine and sine of each harmonic.
    fn lists(&mut self) -> [&mut [f64]; 2] {
        [slice::from_mut(&mut self.mean), self.waves.as_flattened_mut()]
    }
}

impl StoredFields for FiveDays {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "first of five days", &mut self.day)?;
        visitor.number(2, "mean of five days", 0.0..=1.0, &mut self.mean)?;
        visitor.number(3, "bins of five days", f64::MIN_POSITIVE..=f64::MAX, &mut self.bins)
    }
}

impl StoredFields for Class {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let (losses, of_recalled) = self.losses.split_at_mut(FAR_MEMBERS - RECALLED);
        let errors: &mut [&mut [f32]] = &mut [losses, &mut self.explained, slice::from_mut(&mut self.bins)];
        visitor.lists(1, "errors at a lead time", NOT_NEGATIVE, errors)?;
        let [newer, older] = &mut self.stored;
        visitor.messages(2, "newer forecast of a lead time", newer)?;
        visitor.messages(3, "older forecast of a lead time", older)?;
        // Without them no forecast that repeats days was scored.
        let mut recalled: Option<[f32; RECALLED]> = of_recalled.first_chunk().copied();
        visitor.list(4, "errors of recalled days", NOT_NEGATIVE, &mut recalled)?;
        of_recalled.copy_from_slice(&recalled.unwrap_or_default());
        Ok(())
    }
}

impl StoredFields for StoredForecast {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "day of a stored forecast", &mut self.day)?;
        visitor.number(2, "mean of a stored forecast", 0.0..=1.0, &mut self.mean)?;
        let weeks: &mut [&mut [u8]] = &mut [&mut self.week, &mut self.recent, &mut self.chosen];
        visitor.lists(3, "stored forecast of an ensemble", FINITE, weeks)?;
        visitor.lists(4, RHYTHM, -1e6..=1e6, &mut self.rhythm.lists())
    }
}

/// Eight bytes of bits by half-hour, then two half-hours in a byte.
impl Packed for SeenDay {
    const BYTES: usize = <u64 as Packed>::BYTES + SLOTS / 2;

    fn put(&self, bytes: &mut Vec<u8>) {
        self.seen.put(bytes);
        self.values.put(bytes);
    }

    fn take(bytes: &[u8]) -> SeenDay {
        let (seen, values) = bytes.split_at(bytes.len().min(<u64 as Packed>::BYTES));
        SeenDay { seen: Packed::take(seen), values: Packed::take(values) }
    }
}
