//! Forecasts at long lead times: the weights of the members for lead times of a week, a month, a season and a year.
//!
//! A model predicts at the lead times at which it was scored. Every week, four weeks, quarter and year the ensemble
//! stores the forecasts of its members for each hour of the week; half-hour bins at that lead time are compared with
//! the stored forecasts, and with those that repeat days before them. The members are weighted by these losses, for
//! each lead-time class. A class with too few bins takes over the losses of the next days and of the shorter classes
//! for members without a window; in such a class a member with a window has no weight far beyond it. The plain mean has
//! a weight of its own: the share of the bins that it explains, against the pool. Invariant: predictions lie strictly
//! between 0 and 1.

use super::bins::DayBins;
use super::pool::{Member, Pool, normalised};
use super::recalled::{RECALLED, RecalledDays};
use super::season::{Rhythm, Season};
use super::stack::{clip, log_odds, probability};
use crate::{
    LocalDay,
    hours_seen::{HOURS, Hours},
};

/// The shortest lead time of each class, in days. At shorter lead times than the first, the pool of the next days
/// predicts.
pub(super) const AHEAD_DAYS: [i64; 4] = [7, 28, 91, 364];
/// Number of classes.
pub(super) const CLASSES: usize = AHEAD_DAYS.len();
/// Number of classes in which recalled days are used; at longer lead times too few of them are known.
const RECALLED_CLASSES: usize = 2;

/// A member of the ensemble at long lead times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FarMember {
    /// The mean of all bins.
    Mean,
    /// The table of all history.
    Week,
    /// The table with a half-life of a week.
    Recent,
    /// The rhythm of the year.
    Rhythm,
    /// The table of all history, moved by the rhythm of the year.
    WeekAndRhythm,
    /// The mean of the state on the same days of earlier years.
    YearsAgo,
    /// The model that the update chose.
    Chosen,
    /// The earlier days that the best rotation repeats.
    Rotation,
    /// The last days of the same kind.
    Alike,
    /// Days that are the same weekday of their months.
    Nth,
}

/// Number of members.
pub(super) const FAR_MEMBERS: usize = 7 + RECALLED;

const ALL: [FarMember; FAR_MEMBERS] = [
    FarMember::Mean,
    FarMember::Week,
    FarMember::Recent,
    FarMember::Rhythm,
    FarMember::WeekAndRhythm,
    FarMember::YearsAgo,
    FarMember::Chosen,
    FarMember::Rotation,
    FarMember::Alike,
    FarMember::Nth,
];

/// A loss is divided by the shortest lead time of its class in days to this power: bins of days close together score
/// the same forecast.
const DEPENDENCE: f64 = 0.8;
/// With fewer bins a class counts as not scored.
const BINS_MIN: f64 = 20.0;
/// The losses of a class count with this factor for the next longer class.
const CARRIED: f64 = 0.3;
/// The losses of the next days count with this factor, and with [`CARRIED`], for the first class.
const CARRIED_NEAR: f64 = 0.3;
/// A member with a window that is not yet scored has a weight up to a lead time of this many windows.
const WINDOWS: f64 = 4.0;
/// The share of a class's sums that remains after each further observed day.
const KEPT: f64 = 0.995;
/// The prior weight of a member of the year that equals the mean.
const FLAT_YEAR: f64 = 0.15;
/// No forecasts are stored before the record spans this many days.
const SPAN_MIN_DAYS: i64 = 14;
/// At most this many bins of a day count.
const BINS_OF_DAY: f64 = 8.0;
/// The share of the mean before the first bin, and how many bins that counts as.
const MEAN_SHARE: f64 = 0.1;
const MEAN_BINS: f64 = 5.0;

impl FarMember {
    /// The number of days back that the data of the member reaches; `None`: all days.
    fn window_days(self) -> Option<f64> {
        match self {
            FarMember::Recent | FarMember::Alike => Some(7.0),
            // Models are trained on twelve weeks, which is [`WINDOWS`] times this.
            FarMember::Chosen => Some(21.0),
            _ => None,
        }
    }

    /// The prior weight. `has_rhythm`: a rhythm of the year is known; without it, the members of the year equal the
    /// mean.
    fn prior(self, has_rhythm: bool) -> f64 {
        match self {
            FarMember::Rhythm | FarMember::YearsAgo if !has_rhythm => FLAT_YEAR,
            FarMember::Mean | FarMember::Week => 0.25,
            FarMember::Recent | FarMember::Rotation | FarMember::Alike | FarMember::Nth => 0.5,
            FarMember::Rhythm => 1.5,
            FarMember::WeekAndRhythm | FarMember::Chosen => 4.0,
            FarMember::YearsAgo => 2.0,
        }
    }
}

/// Values by hour of the week, in steps of 1/255.
type Bytes = [u8; 7 * HOURS];

fn bytes(week: &[Hours; 7]) -> Bytes {
    let mut bytes = [0; 7 * HOURS];
    // Between 0 and 255.
    bytes
        .iter_mut()
        .zip(week.as_flattened())
        .for_each(|(byte, value)| *byte = (value.clamp(0.0, 1.0) * 255.0).round() as u8);
    bytes
}

/// The stored forecasts of the members for a week, made at the end of a day.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StoredForecast {
    pub(super) day: LocalDay,
    pub(super) mean: f32,
    pub(super) week: Bytes,
    pub(super) recent: Bytes,
    pub(super) chosen: Bytes,
    pub(super) rhythm: Rhythm,
}

/// The current forecasts of the members for a week.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    pub(super) mean: f64,
    pub(super) week: [Hours; 7],
    pub(super) recent: [Hours; 7],
    /// The predictions of the chosen model for the week after the last day.
    pub(super) chosen: [Hours; 7],
    pub(super) rhythm: Rhythm,
}

impl Default for StoredForecast {
    fn default() -> StoredForecast {
        const NONE: Bytes = [0; 7 * HOURS];
        let rhythm = Rhythm::UNKNOWN;
        StoredForecast { day: LocalDay(0), mean: 0.0, week: NONE, recent: NONE, chosen: NONE, rhythm }
    }
}

impl Profile {
    /// A value of all seasons, moved to the season of a day.
    pub(super) fn moved(&self, value: f64, day: LocalDay) -> f64 {
        moved(value, self.rhythm.at(day), clip(self.mean))
    }

    fn stored(&self, day: LocalDay) -> StoredForecast {
        StoredForecast {
            day,
            mean: self.mean as f32,
            week: bytes(&self.week),
            recent: bytes(&self.recent),
            chosen: bytes(&self.chosen),
            rhythm: self.rhythm,
        }
    }
}

/// The losses and the stored forecasts of one lead-time class.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Class {
    pub(super) losses: [f32; FAR_MEMBERS],
    /// Number of bins explained by the pool, and by the mean; each bin is shared in proportion to their weighted
    /// likelihoods.
    pub(super) explained: [f32; 2],
    pub(super) bins: f32,
    /// The stored forecasts of the two last turns of the class, the newer first.
    pub(super) stored: [Option<Box<StoredForecast>>; 2],
}

/// The weights of a lead-time class.
#[derive(Clone, Copy, Debug)]
pub(super) struct FarWeights {
    weights: [f64; FAR_MEMBERS],
    mean_share: f64,
}

/// All lead-time classes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Outlook {
    pub(super) classes: [Class; CLASSES],
}

/// The class of a lead time in days; `None` if it is shorter than the first class.
pub(super) fn class_of(ahead_days: i64) -> Option<usize> {
    AHEAD_DAYS.iter().rposition(|&shortest| ahead_days >= shortest)
}

/// A value moved in log odds by how much a season differs from the mean.
fn moved(value: f64, season: f64, mean: f64) -> f64 {
    probability(log_odds(value) + log_odds(season) - log_odds(mean))
}

/// The predictions of the members without the recalled days at long lead times for an hour of a day.
fn members(parts: (f64, f64, f64, f64), day: LocalDay, rhythm: &Rhythm, season: &Season) -> [f64; FAR_MEMBERS] {
    let (mean, week, recent, chosen) = parts;
    let (mean, week, at) = (clip(mean), clip(week), rhythm.at(day));
    let years_ago = season.years_ago(day, rhythm);
    [mean, week, clip(recent), at, moved(week, at, mean), years_ago, clip(chosen), week, week, week]
}

/// Adds the predictions from the recalled days.
fn with_recalled(mut values: [f64; FAR_MEMBERS], recalled: [f64; RECALLED]) -> [f64; FAR_MEMBERS] {
    for (value, recalled) in values.iter_mut().skip(FarMember::Rotation as usize).zip(recalled) {
        *value = clip(recalled);
    }
    values
}

/// The stored forecasts for an hour of the week, 0 for Monday, midnight.
fn members_of_stored(
    stored: &StoredForecast,
    day: LocalDay,
    hour_of_week: usize,
    season: &Season,
) -> [f64; FAR_MEMBERS] {
    let value = |bytes: &Bytes| f64::from(bytes[hour_of_week]) / 255.0;
    let parts = (f64::from(stored.mean), value(&stored.week), value(&stored.recent), value(&stored.chosen));
    members(parts, day, &stored.rhythm, season)
}

/// The losses of the members on the next days. The members of the year have that of the mean or of the table that they
/// move.
pub(super) fn near_losses(pool: &Pool) -> [f64; FAR_MEMBERS] {
    use Member::{Alike, Chosen, Mean, Nth, RecentWeekday, Rotation, Weekday};
    [Mean, Weekday, RecentWeekday, Mean, Weekday, Mean, Chosen, Rotation, Alike, Nth].map(|member| pool.counted(member))
}

/// The weighted mean of the members.
fn pooled(values: &[f64; FAR_MEMBERS], weights: &[f64; FAR_MEMBERS]) -> f64 {
    values.iter().zip(weights).map(|(value, weight)| value * weight).sum()
}

impl FarWeights {
    /// The prediction for a half-hour of a day. `recalled`: the days before.
    pub(super) fn predict(
        &self,
        profile: &Profile,
        (day, slot): (LocalDay, usize),
        chosen: f64,
        season: &Season,
        recalled: &RecalledDays<'_>,
    ) -> f64 {
        let (weekday, hour) = (day.weekday(), slot / 2);
        let week = profile.week[weekday][hour];
        let parts = (profile.mean, week, profile.recent[weekday][hour], chosen);
        let values = with_recalled(members(parts, day, &profile.rhythm, season), recalled.at(slot, clip(week)));
        (1.0 - self.mean_share) * pooled(&values, &self.weights) + self.mean_share * values[FarMember::Mean as usize]
    }
}

impl Outlook {
    pub(super) const fn new() -> Outlook {
        const CLASS: Class = Class { losses: [0.0; FAR_MEMBERS], explained: [0.0; 2], bins: 0.0, stored: [None, None] };
        Outlook { classes: [CLASS; CLASSES] }
    }

    fn mean_share(&self, class: usize) -> f64 {
        let [pool, mean] = self.classes[class].explained.map(f64::from);
        (mean + MEAN_SHARE * MEAN_BINS) / (pool + mean + MEAN_BINS)
    }

    /// The weights of a class. `has_rhythm`: a rhythm of the year is known; `near`: the losses of the members on the
    /// next days.
    pub(super) fn weights(&self, class: usize, has_rhythm: bool, near: &[f64; FAR_MEMBERS]) -> FarWeights {
        let counted = |class: usize, member: usize| {
            f64::from(self.classes[class].losses[member]) * libm::pow(AHEAD_DAYS[class] as f64, -DEPENDENCE)
        };
        let bins = f64::from(self.classes[class].bins);
        let mut logs = [0.0; FAR_MEMBERS];
        for (place, (log, member)) in logs.iter_mut().zip(ALL).enumerate() {
            *log = libm::log(member.prior(has_rhythm)) - counted(class, place);
            let beyond = |days: f64| WINDOWS * days < AHEAD_DAYS[class] as f64;
            let is_forgotten = place >= FarMember::Rotation as usize && class >= RECALLED_CLASSES;
            if is_forgotten || bins < BINS_MIN && member.window_days().is_some_and(beyond) {
                *log = f64::NEG_INFINITY;
            }
        }
        let unlimited = |place: &usize| ALL[*place].window_days().is_none();
        let mut carry = |classes: usize, factor: f64, loss: &dyn Fn(usize) -> f64| {
            let least = (0..FAR_MEMBERS).filter(unlimited).map(loss).fold(f64::INFINITY, f64::min);
            let carried = factor * libm::pow(CARRIED, classes as f64) * BINS_MIN / (BINS_MIN + bins);
            for (place, log) in logs.iter_mut().enumerate() {
                *log -= carried * if unlimited(&place) { loss(place) } else { least };
            }
        };
        carry(class + 1, CARRIED_NEAR, &|place| near[place]);
        for shorter in 0..class {
            carry(class - shorter, 1.0, &|place| counted(shorter, place));
        }
        FarWeights { weights: normalised(logs), mean_share: self.mean_share(class) }
    }

    /// Scores the stored forecasts on the bins of a day, in each class whose lead time the day has. `near`: the
    /// losses of the members on the next days; `recalled`: the days before a cut that a forecast for the day uses.
    pub(super) fn judge<'a>(
        &mut self,
        day: LocalDay,
        bins: &DayBins,
        season: &Season,
        near: &[f64; FAR_MEMBERS],
        recalled: impl Fn(LocalDay) -> RecalledDays<'a>,
    ) {
        let seen: Vec<(usize, f64)> = bins.seen().collect();
        if seen.is_empty() {
            return;
        }
        for (class, &ahead_days) in AHEAD_DAYS.iter().enumerate() {
            let far = self.weights(class, season.rhythm.is_known(), near);
            let known = &mut self.classes[class];
            let Some(stored) = known.stored[1].as_deref() else { continue };
            if i64::from(day.0) - i64::from(stored.day.0) < ahead_days {
                continue;
            }
            let (mut explained, mut losses) = ([0.0; 2], [0.0; FAR_MEMBERS]);
            let recalled = recalled(stored.day);
            let mut last: Option<(usize, [f64; FAR_MEMBERS])> = None;
            for &(slot, value) in &seen {
                let hour = day.weekday() * HOURS + slot / 2;
                let values = match last {
                    Some((known, values)) if known == hour => values,
                    _ => members_of_stored(stored, day, hour, season),
                };
                last = Some((hour, values));
                let values = with_recalled(values, recalled.at(slot, values[FarMember::Week as usize]));
                let likelihood = |p: f64| p * value + (1.0 - p) * (1.0 - value);
                let by_pool = (1.0 - far.mean_share) * likelihood(clip(pooled(&values, &far.weights)));
                let by_mean = far.mean_share * likelihood(values[FarMember::Mean as usize]);
                explained[0] += by_pool / (by_pool + by_mean);
                explained[1] += by_mean / (by_pool + by_mean);
                for (loss, p) in losses.iter_mut().zip(values) {
                    *loss -= value * libm::log(p) + (1.0 - value) * libm::log(1.0 - p);
                }
            }
            let number = seen.len() as f64;
            let counted = number.min(BINS_OF_DAY);
            let add = |sum: &mut f32, more: f64| *sum = (KEPT * f64::from(*sum) + more / number * counted) as f32;
            known.losses.iter_mut().zip(losses).for_each(|(sum, loss)| add(sum, loss));
            known.explained.iter_mut().zip(explained).for_each(|(sum, more)| add(sum, more));
            add(&mut known.bins, number);
        }
    }

    /// The classes that store the forecasts at the end of a day: those whose turn lies in the days after `last`. None
    /// does while the record is short. `first`: its first day.
    pub(super) fn turns(last: Option<LocalDay>, day: LocalDay, first: Option<LocalDay>) -> [bool; CLASSES] {
        if first.is_none_or(|first| i64::from(day.0) - i64::from(first.0) < SPAN_MIN_DAYS) {
            return [false; CLASSES];
        }
        let turn = |day: LocalDay, days: i64| i64::from(day.0).div_euclid(days);
        AHEAD_DAYS.map(|days| last.is_none_or(|last| turn(last, days) != turn(day, days)))
    }

    /// Stores the forecasts at the end of a day.
    pub(super) fn keep(&mut self, turns: [bool; CLASSES], day: LocalDay, profile: &Profile) {
        for (class, _) in self.classes.iter_mut().zip(turns).filter(|(_, turn)| *turn) {
            class.stored[1] = class.stored[0].replace(Box::new(profile.stored(day)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNSCORED: [f64; FAR_MEMBERS] = [0.0; FAR_MEMBERS];

    #[test]
    fn lead_times_have_classes() {
        assert_eq!([0, 6, 7, 27, 28, 90, 91, 363, 364, 9_999].map(class_of), {
            [None, None, Some(0), Some(0), Some(1), Some(1), Some(2), Some(2), Some(3), Some(3)]
        });
    }

    #[test]
    fn a_window_is_not_used_beyond_itself_before_it_is_scored() {
        let outlook = Outlook::new();
        let (near, far) = (outlook.weights(0, false, &UNSCORED), outlook.weights(2, false, &UNSCORED));
        let recent = FarMember::Recent as usize;
        assert!(near.weights[recent] > 0.0 && far.weights[recent] == 0.0);
        assert_eq!(outlook.weights(3, false, &UNSCORED).weights[FarMember::Chosen as usize], 0.0);
        assert!((far.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn forecasts_are_stored_at_the_turn_of_each_class() {
        assert_eq!(Outlook::turns(None, LocalDay(3), Some(LocalDay(-40))), [true; 4]);
        assert_eq!(Outlook::turns(Some(LocalDay(6)), LocalDay(7), Some(LocalDay(-7))), [true, false, false, false]);
        assert_eq!(Outlook::turns(Some(LocalDay(8)), LocalDay(12), Some(LocalDay(-40))), [false; 4]);
        assert_eq!(Outlook::turns(Some(LocalDay(8)), LocalDay(29), Some(LocalDay(-40))), [true, true, false, false]);
    }
}
