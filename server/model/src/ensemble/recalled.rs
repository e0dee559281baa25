//! The earlier days that a forecast repeats: those of the best rotation, the last days of the same kind, and the same
//! weekdays of earlier months.
//!
//! Invariant: a forecast with a cut uses no day after the cut.

use super::recall::{DAYS, Recall, SeenDay};
use crate::LocalDay;
use crate::hours_seen::kind_of_day;

/// Number of members that repeat earlier days.
pub(super) const RECALLED: usize = 3;
/// The place of the rotation among them, and of the same weekdays of earlier months.
pub(super) const ROTATION: usize = 0;
pub(super) const NTH: usize = 2;
/// A rotation uses values of up to this many days back for the next days, and at longer lead times.
pub(super) const ROTATION_DAYS: i32 = 84;
pub(super) const FAR_ROTATION_DAYS: i32 = DAYS as i32 - 1;
/// A value of a rotation counts half after this many days.
const ROTATION_HALF_LIFE: f64 = 60.0;
/// The weight of a day of the same kind, relative to the next newer one, and the number of days that count.
pub(super) const ALIKE_KEPT: f64 = 0.7;
const ALIKE_DAYS: usize = 12;
/// The weekday table counts as this many bins, beside those of the days of each member.
const TABLE_BINS: [f64; RECALLED] = [1.0, 1.0, 0.5];

/// The days, with their weights, of each member: rotation, days of the kind, same weekday of the month.
#[derive(Clone, Debug)]
pub(super) struct RecalledDays<'a> {
    days: [Vec<(&'a SeenDay, f64)>; RECALLED],
}

impl<'a> RecalledDays<'a> {
    /// The days that a forecast for a day repeats, up to a cut. `rotation`: the number of days of the rotation, and how
    /// many days back it uses values.
    pub(super) fn new(recall: &'a Recall, rotation: (i32, i32), day: LocalDay, cut: LocalDay) -> RecalledDays<'a> {
        let (rotation, rotation_days) = rotation;
        let seen = |back: i32| recall.day(LocalDay(day.0.saturating_sub(back)));
        let is_known = |&back: &i32| day.0.saturating_sub(back) <= cut.0;
        let turns = (1..).map(|turn| turn * rotation).take_while(|&back| back <= rotation_days);
        let turned = turns
            .filter(is_known)
            .filter_map(|back| Some((seen(back)?, libm::exp2(-f64::from(back) / ROTATION_HALF_LIFE))));
        let kind = kind_of_day(day.weekday());
        let first = (i64::from(day.0) - i64::from(cut.0)).clamp(1, DAYS as i64) as i32;
        let alike = (first..DAYS as i32)
            .filter(|back| kind_of_day(LocalDay(day.0.saturating_sub(*back)).weekday()) == kind)
            .take(ALIKE_DAYS)
            .enumerate()
            .filter_map(|(number, back)| Some((seen(back)?, libm::pow(ALIKE_KEPT, number as f64))));
        let nth = same_weekdays_of_month(day).into_iter().filter(is_known).filter_map(|back| Some((seen(back)?, 1.0)));
        RecalledDays { days: [turned.collect(), alike.collect(), nth.collect()] }
    }

    /// The predictions of the members at a half-hour. `table`: that of the weekday table.
    pub(super) fn at(&self, slot: usize, table: f64) -> [f64; RECALLED] {
        std::array::from_fn(|member| self.of_member(member, slot, table))
    }

    /// The prediction of one of the members.
    pub(super) fn of_member(&self, member: usize, slot: usize, table: f64) -> f64 {
        let bins = TABLE_BINS[member];
        let seen = self.days[member].iter().filter_map(|(day, weight)| Some((day.value(slot)?, *weight)));
        let add = |(sum, number): (f64, f64), (value, weight): (f64, f64)| (sum + weight * value, number + weight);
        let (sum, number) = seen.fold((bins * table, bins), add);
        sum / number
    }
}

/// The numbers of days back to the same weekdays of earlier months, such as the first Mondays.
fn same_weekdays_of_month(day: LocalDay) -> Vec<i32> {
    let number = |day: LocalDay| (day.date().2 - 1) / 7;
    let of_day = number(day);
    let weeks = (1..=DAYS as i32 / 7).map(|week| 7 * week);
    weeks.filter(|&back| number(LocalDay(day.0.saturating_sub(back))) == of_day).collect()
}
