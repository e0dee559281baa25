//! The number of days after which a state repeats, apart from the week: rotations of shifts of 4 to 42 days.
//!
//! The residual of each half-hour bin from the weekday table is compared with the residual of the same half-hour so
//! many days before. The sum of the products, divided by the root of the sum of their squares by day, is large for the
//! true rotation and its multiples. A wrong choice does little: it only smooths over some days. Invariant: the numbers
//! of days are [`SHORTEST`]`..=`[`LONGEST`] without the week.

use super::bins::SLOTS;
use crate::LocalDay;

/// The shortest rotation in days.
pub(super) const SHORTEST: usize = 2;
/// The longest rotation in days.
pub(super) const LONGEST: usize = 42;
/// The week has its own table.
const WEEK: usize = 7;
/// The share of the sums that remains after each further observed day.
const KEPT: f64 = 0.985;
/// Number of steps between residuals of 0 and of 1.
const STEPS: f64 = 127.0;

/// Number of rotations to choose from.
pub(super) const ROTATIONS: usize = LONGEST - SHORTEST + 1;

/// The residuals of the last days, and the fit of each rotation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Rotation {
    /// Indexed by the day's number modulo [`LONGEST`]; empty before the first day.
    pub(super) residuals: Vec<[i8; SLOTS]>,
    /// Faded sums of the daily sums of products, and of their squares, by number of days from [`SHORTEST`].
    pub(super) products: [f32; ROTATIONS],
    pub(super) squares: [f32; ROTATIONS],
    pub(super) last: Option<LocalDay>,
}

impl Rotation {
    pub(super) const fn new() -> Rotation {
        Rotation { residuals: Vec::new(), products: [0.0; ROTATIONS], squares: [0.0; ROTATIONS], last: None }
    }

    fn place(day: LocalDay) -> usize {
        day.0.rem_euclid(LONGEST as i32) as usize
    }

    /// The number of days after which the state seems to repeat.
    pub(super) fn days(&self) -> usize {
        let (mut best, mut highest) = (SHORTEST, f64::MIN);
        for (index, (&product, &square)) in self.products.iter().zip(&self.squares).enumerate() {
            let score = f64::from(product) / (f64::from(square) + 1e-9).sqrt();
            if index + SHORTEST != WEEK && score > highest {
                (best, highest) = (index + SHORTEST, score);
            }
        }
        best
    }

    /// Learns the residuals of a day that is newer than all learned days, 0 where there is no bin.
    pub(super) fn learn(&mut self, day: LocalDay, residuals: &[f64; SLOTS]) {
        if self.residuals.is_empty() {
            self.residuals = vec![[0; SLOTS]; LONGEST];
        }
        let passed =
            self.last.map_or(LONGEST as i64, |last| i64::from(day.0) - i64::from(last.0)).clamp(1, LONGEST as i64);
        // The place of `day` still has the residuals of [`LONGEST`] days ago, unless that many days have passed.
        for back in 1..passed {
            self.residuals[Self::place(LocalDay(day.0.saturating_sub(back as i32)))] = [0; SLOTS];
        }
        if passed == LONGEST as i64 {
            self.residuals[Self::place(day)] = [0; SLOTS];
        }
        for (index, (product, square)) in self.products.iter_mut().zip(&mut self.squares).enumerate() {
            let days = index + SHORTEST;
            if days == WEEK {
                continue;
            }
            let before = &self.residuals[Self::place(LocalDay(day.0.saturating_sub(days as i32)))];
            let sum: f64 = residuals.iter().zip(before).map(|(now, &before)| now * f64::from(before) / STEPS).sum();
            *product = (KEPT * f64::from(*product) + sum) as f32;
            *square = (KEPT * f64::from(*square) + sum * sum) as f32;
        }
        // Between -127 and 127.
        self.residuals[Self::place(day)] = residuals.map(|residual| (residual.clamp(-1.0, 1.0) * STEPS).round() as i8);
        self.last = Some(day);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_of_shifts_is_found_within_weeks() {
        for (days, weeks) in [(4, 4), (6, 5), (10, 7), (14, 9)] {
            let mut rotation = Rotation::new();
            for day in 0..7 * weeks {
                let on = day % days < days / 2;
                let mut residuals = [0.0; SLOTS];
                residuals[16..32].fill(if on { 0.5 } else { -0.5 });
                rotation.learn(LocalDay(day), &residuals);
            }
            assert_eq!(rotation.days() % days as usize, 0, "{days}: {}", rotation.days());
        }
    }

    #[test]
    fn days_that_nobody_saw_do_not_count_as_repeated() {
        let mut rotation = Rotation::new();
        rotation.learn(LocalDay(0), &[1.0; SLOTS]);
        rotation.learn(LocalDay(100), &[1.0; SLOTS]);
        rotation.learn(LocalDay(101), &[1.0; SLOTS]);
        assert_eq!((rotation.products, rotation.squares), ([0.0; ROTATIONS], [0.0; ROTATIONS]));
        rotation.learn(LocalDay(102), &[-1.0; SLOTS]);
        assert_eq!(rotation.products[0], -(SLOTS as f32));
    }
}
