//! The predictions of an ensemble for one local day by half-hour, and at long lead times.
//!
//! Invariant: a forecast of a day uses no half-hour bin of that day except those in the tables.

use super::bins::{SLOT_NANOS, SLOTS, slot_at};
use super::outlook::{CLASSES, class_of, near_losses};
use super::pool::{MEMBERS, Member};
use super::recalled::{FAR_ROTATION_DAYS, NTH, ROTATION, ROTATION_DAYS, RecalledDays};
use super::stack::{FEATURES, Features, clip, log_odds};
use super::week_table::DayLevels;
use super::{Ensemble, FarView};
use crate::{
    LocalDay, Predictive,
    hours_seen::{HOURS, evidence, kind_of_day},
    models::{Moment, TemporalModel},
};

/// The members whose log odds the stacks combine, in the order of the features.
const STACKED: [Member; super::stack::MEMBERS] =
    [Member::Kind, Member::Weekday, Member::RecentKind, Member::Rotation, Member::Alike, Member::Nth, Member::Chosen];
/// The residuals that the stacks combine: index of the residual, and how many days back its day is. The residual of the
/// last day of the kind has the index [`LAST_ALIKE`].
const DAYS_AGO: [(usize, i32); 5] = [(0, 1), (1, 2), (2, 7), (3, 14), (5, 28)];
const LAST_ALIKE: usize = 4;
/// A chosen model with less weight is not evaluated at the moment itself; its value at the half-hour is used.
const WEIGHT_MIN: f64 = 0.01;
/// Up to a lead time of this many days the pool of the next days predicts.
const NEXT_DAYS: i64 = 6;
const DAY_NANOS: i64 = SLOTS as i64 * SLOT_NANOS;

/// The members' predictions for a day.
#[derive(Clone, Debug)]
pub(super) struct MemberDay {
    /// The predictions by member, then by half-hour.
    pub(super) values: [[f64; SLOTS]; MEMBERS],
    pub(super) features: Features,
    pub(super) all: DayLevels,
    pub(super) recent: DayLevels,
}

/// The predictions of an ensemble for one local day.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DayForecast {
    /// The weighted sum of the members of the pool without the chosen model.
    rest: [f64; SLOTS],
    /// The predictions of the chosen model, and the weight of the model in the pool.
    chosen: [f64; SLOTS],
    chosen_weight: f64,
    /// The prediction by hour that counts where there are few bins: of the smooth table, else of the weekday table.
    smooth: [f64; HOURS],
    /// The equivalent number of bins of each hour.
    bins: [f64; HOURS],
    mean: f64,
    factor: f64,
    dependence: f64,
}

/// A local civil time of a day as a moment; its offset does not matter to a model of habits.
pub(super) fn civil_moment(day: LocalDay, nanos: i64) -> Moment {
    Moment { utc_nanos: i64::from(day.0).saturating_mul(DAY_NANOS).saturating_add(nanos), offset_secs: 0 }
}

impl DayForecast {
    /// The mean towards which predictions are corrected.
    pub(super) fn mean(&self) -> f64 {
        self.mean
    }

    /// The prediction of the pool at a half-hour, before the correction.
    pub(super) fn uncorrected(&self, slot: usize) -> f64 {
        self.rest[slot] + self.chosen_weight * self.chosen[slot]
    }

    /// The prediction at a half-hour.
    pub(super) fn at_slot(&self, slot: usize) -> f64 {
        self.corrected(slot, self.uncorrected(slot))
    }

    fn corrected(&self, slot: usize, pool: f64) -> f64 {
        let smooth = self.smooth[slot / 2];
        let value = smooth + evidence(self.bins[slot / 2]) * (pool - smooth);
        clip(self.mean + self.factor * (value - self.mean))
    }

    /// The prediction at a half-hour for another prediction of the chosen model.
    pub(super) fn with_chosen(&self, slot: usize, chosen: f64) -> f64 {
        self.corrected(slot, self.rest[slot] + self.chosen_weight * clip(chosen))
    }

    /// The prediction at a moment of the day.
    fn predict(&self, at: Moment, chosen: &dyn TemporalModel) -> f64 {
        let slot = slot_at(at.civil_nanos());
        if self.chosen_weight < WEIGHT_MIN {
            return self.at_slot(slot);
        }
        self.with_chosen(slot, chosen.predict(at))
    }

    fn predictive(&self, at: Moment, chosen: &dyn TemporalModel) -> Predictive {
        let hour = slot_at(at.civil_nanos()) / 2;
        Predictive::new(self.predict(at, chosen), self.bins[hour], self.dependence)
    }
}

impl Ensemble {
    /// The predictions of the members for a day, from the learned data of other days.
    pub(super) fn members(&self, day: LocalDay, chosen: &dyn TemporalModel) -> MemberDay {
        let (mean, weekday) = (self.mean(), day.weekday());
        let kind = kind_of_day(weekday);
        let (all, recent) = (self.all.levels(weekday, mean), self.recent.levels(weekday, mean));
        let mut values = [[0.0; SLOTS]; MEMBERS];
        let mut features = [[0.0; FEATURES]; SLOTS];
        let rotation = (self.rotation.days() as i32, ROTATION_DAYS);
        let recalled = RecalledDays::new(&self.recall, rotation, day, LocalDay(day.0.saturating_sub(1)));
        for slot in 0..SLOTS {
            let hour = slot / 2;
            let base = all.weekday[hour];
            let mut set = |member: Member, value: f64| values[member as usize][slot] = clip(value);
            set(Member::Mean, mean);
            set(Member::Hour, all.hour[hour]);
            set(Member::Kind, all.kind[hour]);
            set(Member::Weekday, base);
            set(Member::RecentKind, recent.kind[hour]);
            set(Member::RecentWeekday, recent.weekday[hour]);
            set(Member::Rotation, recalled.of_member(ROTATION, slot, base));
            let (sum, number) = (f64::from(self.alike.sums[kind][slot]), f64::from(self.alike.bins[kind][slot]));
            set(Member::Alike, (sum + base) / (number + 1.0));
            set(Member::Nth, recalled.of_member(NTH, slot, base));
            set(Member::Chosen, chosen.predict(civil_moment(day, slot as i64 * SLOT_NANOS + SLOT_NANOS / 2)));
            set(Member::Smooth, self.smooth.map_or(base, |smooth| smooth[kind][hour]));
            let x = &mut features[slot];
            for (feature, member) in x.iter_mut().zip(STACKED) {
                *feature = log_odds(values[member as usize][slot]);
            }
            let residuals = &mut x[STACKED.len()..];
            for (place, back) in DAYS_AGO {
                let before = self.recall.day(LocalDay(day.0.saturating_sub(back)));
                residuals[place] = before.and_then(|before| before.value_near(slot)).map_or(0.0, |value| value - base);
            }
            let last = f64::from(self.alike.last[kind][slot]);
            residuals[LAST_ALIKE] = if last < 0.0 { 0.0 } else { last - base };
            x[FEATURES - 1] = 1.0;
            for (stack, member) in self.stacks.iter().zip([Member::SlowStack, Member::FastStack]) {
                values[member as usize][slot] = stack.predict(x);
            }
        }
        MemberDay { values, features, all, recent }
    }

    /// The combined forecast of the members.
    pub(super) fn forecast_of(&self, day: LocalDay, members: &MemberDay) -> DayForecast {
        let weights = self.pool.weights(self.bins);
        let kind = kind_of_day(day.weekday());
        let mut rest = [0.0; SLOTS];
        for (place, (values, weight)) in members.values.iter().zip(weights).enumerate() {
            if place != Member::Chosen as usize {
                rest.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        DayForecast {
            rest,
            chosen: members.values[Member::Chosen as usize],
            chosen_weight: weights[Member::Chosen as usize],
            // Every hour has enough bins where there is no smooth table.
            smooth: self.smooth.map_or(members.all.weekday, |smooth| smooth[kind]).map(clip),
            bins: self.known[kind],
            mean: clip(self.mean()),
            factor: self.calibration.factor(),
            dependence: self.calibration.dependence(),
        }
    }

    /// Whether the pool of the next days predicts a day; else the lead time is too long, or the day too long ago.
    fn near(&self, day: LocalDay) -> bool {
        self.last_day().is_none_or(|last| (i64::from(day.0) - i64::from(last.0)).abs() <= NEXT_DAYS)
    }

    fn far(&self, chosen: &dyn TemporalModel) -> &FarView {
        self.far.get_or_init(|| {
            let profile = self.profile(chosen);
            let (mut classes, near) = (0..CLASSES, near_losses(&self.pool));
            let has_rhythm = self.season.rhythm.is_known();
            let weights = [(); CLASSES].map(|()| self.outlook.weights(classes.next().unwrap_or(0), has_rhythm, &near));
            Box::new(FarView { profile, weights })
        })
    }

    /// The predictive distribution around another model's prediction for a moment.
    pub fn around(&self, at: Moment, probability: f64) -> Predictive {
        let civil_nanos = at.civil_nanos();
        let kind = kind_of_day(LocalDay::of_civil_nanos(civil_nanos).weekday());
        let bins = self.known[kind][slot_at(civil_nanos) / 2];
        Predictive::new(probability, bins, self.calibration.dependence())
    }

    /// Predictions at moments; faster if the moments are in order of time, because each day is then forecast once.
    /// `chosen`: the model that the update has chosen.
    pub fn predict(&self, moments: &[Moment], chosen: &dyn TemporalModel) -> Vec<Predictive> {
        let mut of_day: Option<(LocalDay, DayForecast)> = None;
        let mut far_day: Option<(LocalDay, RecalledDays<'_>)> = None;
        let predict = |&at: &Moment| {
            let day = LocalDay::of_civil_nanos(at.civil_nanos());
            if !self.near(day) {
                let known = far_day.take().filter(|(known, _)| *known == day);
                let (_, recalled) = far_day.insert(known.unwrap_or_else(|| (day, self.recalled_far(day))));
                return self.predict_far(at, day, chosen, recalled);
            }
            let forecast = match of_day.take() {
                Some((known, forecast)) if known == day => forecast,
                _ => match &self.prepared {
                    Some(prepared) if prepared.day == day => prepared.forecast.clone(),
                    _ => self.forecast_of(day, &self.members(day, chosen)),
                },
            };
            let predicted = forecast.predictive(at, chosen);
            of_day = Some((day, forecast));
            predicted
        };
        moments.iter().map(predict).collect()
    }

    /// The days that a forecast at a long lead time repeats.
    fn recalled_far(&self, day: LocalDay) -> RecalledDays<'_> {
        let rotation = (self.rotation.days() as i32, FAR_ROTATION_DAYS);
        RecalledDays::new(&self.recall, rotation, day, self.last_day().unwrap_or(day))
    }

    fn predict_far(
        &self,
        at: Moment,
        day: LocalDay,
        chosen: &dyn TemporalModel,
        recalled: &RecalledDays<'_>,
    ) -> Predictive {
        let far = self.far(chosen);
        let ahead = self.last_day().map_or(0, |last| (i64::from(day.0) - i64::from(last.0)).abs());
        let (class, kind) = (class_of(ahead).unwrap_or(0), kind_of_day(day.weekday()));
        let slot = slot_at(at.civil_nanos());
        let hour = slot / 2;
        let pool = far.weights[class].predict(&far.profile, (day, slot), chosen.predict(at), &self.season, recalled);
        let bins = self.known[kind][hour];
        let value = self.smooth.map_or(pool, |smooth| {
            let smooth = far.profile.moved(clip(smooth[kind][hour]), day);
            smooth + evidence(bins) * (pool - smooth)
        });
        Predictive::new(clip(value), bins, self.calibration.dependence())
    }
}
