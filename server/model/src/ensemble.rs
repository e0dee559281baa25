//! An ensemble of members that predict the half-hour bins of one state, weighted by how well each has predicted before.
//!
//! The members are tables by hour of the week with all history and with a half-life of a week, rotations of some days,
//! the last days of the same kind, the same weekday of the month, a smooth table for few bins, stacks of all of these
//! and of the residuals of the last days, and the model that the nightly update chose. A half-hour bin is the mean of
//! the readings of one half-hour of one day ([`bins`]): more readings in a bin add no certainty. Each local day is
//! predicted, the members are scored on its bins (T-RO section IV.B), and then the day is learned. Up to a lead time of
//! six days the pool of the next days predicts; at longer lead times the members are weighted by how well they
//! predicted at such lead times ([`outlook`]). At hours with very few bins the smooth table predicts.
//!
//! Invariant: the learned data of an ensemble is a function of the bins and their days, as long as days come in order
//! and are not split; predictions are at least 0.001 away from 0 and 1.

mod any;
mod bins;
mod calibration;
mod fields;
mod forecast;
mod numbers;
mod outlook;
mod pool;
mod recall;
mod recalled;
mod rotation;
mod season;
mod smooth_table;
mod stack;
mod trained;
mod week_table;

use std::sync::OnceLock;

pub use any::AnyEnsemble;
use bins::{DayBins, SLOT_NANOS, SLOTS, slot_at};
use calibration::Calibration;
use forecast::{DayForecast, MemberDay};
pub use numbers::{NumberEnsemble, OtherModels};
use outlook::{FarWeights, Outlook, Profile, near_losses};
use pool::{Member, Pool};
use recall::Recall;
use recalled::{ALIKE_KEPT, FAR_ROTATION_DAYS, RecalledDays};
use rotation::Rotation;
use season::Season;
use smooth_table::{KindHours, smooth_table};
use stack::{Stack, clip};
pub use trained::TrainedEnsemble;
use week_table::WeekTable;

use crate::special::square;
use crate::{
    LocalDay, Sample,
    hours_seen::{HOURS, equivalent_bins, kind_of_day},
    models::TemporalModel,
};

/// The half-life of the recent table, in days.
const RECENT_DAYS: f64 = 7.0;
/// The shares of their sums that the stacks keep after each further observed day.
const SLOW: f64 = 0.985;
const FAST: f64 = 0.94;
/// The smooth table is computed again when the number of bins has grown by this share.
const SMOOTH_GROWTH: f64 = 0.05;
/// With this many equivalent bins at every hour the smooth table is not needed.
const SMOOTH_BINS: f64 = 8.0;

/// The last days of weekdays and of weekends, by half-hour.
#[derive(Clone, Copy, Debug, PartialEq)]
struct AlikeDays {
    sums: [[f32; SLOTS]; 2],
    bins: [[f32; SLOTS]; 2],
    /// The value of the newest bin; negative: none.
    last: [[f32; SLOTS]; 2],
}

/// The forecasts for long lead times, computed at the first request.
#[derive(Clone, Debug)]
struct FarView {
    profile: Profile,
    weights: [FarWeights; outlook::CLASSES],
}

/// An ensemble of one state of probabilities.
#[derive(Clone, Debug)]
pub struct Ensemble {
    sum: f64,
    bins: f64,
    all: WeekTable,
    recent: WeekTable,
    alike: AlikeDays,
    recall: Recall,
    rotation: Rotation,
    season: Season,
    stacks: [Stack; 2],
    pool: Pool,
    outlook: Outlook,
    calibration: Calibration,
    smooth: Option<KindHours>,
    smooth_bins: f64,
    /// Equivalent number of bins of each hour; follows from the table of all history.
    known: KindHours,
    /// Computed on demand from the other fields.
    far: OnceLock<Box<FarView>>,
    /// The day that is about to be learned; between updates there is none.
    prepared: Option<Box<PreparedDay>>,
}

/// The predictions for a day before it is learned.
#[derive(Clone, Debug)]
struct PreparedDay {
    day: LocalDay,
    members: MemberDay,
    forecast: DayForecast,
}

/// Compares what is stored.
impl PartialEq for Ensemble {
    fn eq(&self, other: &Ensemble) -> bool {
        let stored = |one: &Ensemble| (one.sum, one.bins, one.alike, one.calibration, one.smooth, one.smooth_bins);
        stored(self) == stored(other)
            && self.all == other.all
            && self.recent == other.recent
            && self.recall == other.recall
            && self.rotation == other.rotation
            && self.season == other.season
            && self.stacks == other.stacks
            && self.pool == other.pool
            && self.outlook == other.outlook
    }
}

impl Default for Ensemble {
    fn default() -> Ensemble {
        Ensemble::new()
    }
}

impl Ensemble {
    /// An ensemble that has learned no bins.
    pub fn new() -> Ensemble {
        Ensemble {
            sum: 0.0,
            bins: 0.0,
            all: WeekTable::new(None),
            recent: WeekTable::new(Some(RECENT_DAYS)),
            alike: AlikeDays { sums: [[0.0; SLOTS]; 2], bins: [[0.0; SLOTS]; 2], last: [[-1.0; SLOTS]; 2] },
            recall: Recall::new(),
            rotation: Rotation::new(),
            season: Season::new(),
            stacks: [Stack::new(SLOW), Stack::new(FAST)],
            pool: Pool::new(),
            outlook: Outlook::new(),
            calibration: Calibration::new(),
            smooth: None,
            smooth_bins: 0.0,
            known: [[0.0; HOURS]; 2],
            far: OnceLock::new(),
            prepared: None,
        }
    }

    /// Number of learned bins: half-hours of single days with a reading.
    pub fn bins(&self) -> f64 {
        self.bins
    }

    /// The last learned day.
    pub fn last_day(&self) -> Option<LocalDay> {
        self.recall.last()
    }

    /// The mean of all bins and of one further bin with the value 0.5.
    pub fn mean(&self) -> f64 {
        (self.sum + 0.5) / (self.bins + 1.0)
    }

    /// Predicts a day that is about to be learned, once for all callers that score its readings. A day that is not
    /// newer than all learned days is not predicted. `chosen`: the model that the update had chosen before the day.
    pub fn prepare(&mut self, day: LocalDay, chosen: &dyn TemporalModel) {
        let last = self.recall.last();
        if last.is_some_and(|last| day <= last) || self.prepared.as_ref().is_some_and(|known| known.day == day) {
            return;
        }
        self.far.take();
        if let Some(last) = last {
            self.pass(last, day);
        }
        let members = self.members(day, chosen);
        let forecast = self.forecast_of(day, &members);
        self.prepared = Some(Box::new(PreparedDay { day, members, forecast }));
    }

    /// Sets whether the map names the year as a period: then a rhythm of the year needs no evidence.
    pub fn expect_year(&mut self, is_expected: bool) {
        self.season.is_expected = is_expected;
    }

    /// Learns a local day: scores all members on its bins, then adds the bins. A day that is not newer than all learned
    /// days is added without scoring. `samples`: the readings of the day in order of time; `chosen`: the model that the
    /// update had chosen before the day. Returns the sum of the squared errors of the predictions for `newer`, the
    /// samples that no earlier day has; `None` where the day was not scored.
    pub fn learn_day(
        &mut self,
        day: LocalDay,
        samples: &[Sample],
        newer: &[Sample],
        chosen: &dyn TemporalModel,
    ) -> Option<f64> {
        let parts = bin_parts(samples, chosen);
        let forecast = self.learn(day, &DayBins::of_samples(samples), chosen, &bin_losses(&parts));
        let forecast = forecast?;
        let error = |parts: &[BinPart]| parts.iter().map(|part| part.squared_error(&forecast)).sum();
        Some(if newer.len() == samples.len() { error(&parts) } else { error(&bin_parts(newer, chosen)) })
    }

    fn learn(
        &mut self,
        day: LocalDay,
        bins: &DayBins,
        chosen: &dyn TemporalModel,
        chosen_losses: &[f64; SLOTS],
    ) -> Option<DayForecast> {
        if bins.is_empty() {
            return None;
        }
        let last = self.recall.last();
        self.prepare(day, chosen);
        self.far.take();
        let Some(prepared) = self.prepared.take() else {
            self.add_late(day, bins);
            return None;
        };
        let PreparedDay { members, forecast, .. } = *prepared;
        for stack in &mut self.stacks {
            stack.learn(&members.features, bins);
        }
        let mut losses = [0.0; pool::MEMBERS];
        for (slot, value) in bins.seen() {
            for (loss, predicted) in losses.iter_mut().zip(&members.values) {
                *loss += pool::loss(predicted[slot], value);
            }
            let own = &mut losses[Member::Chosen as usize];
            *own += chosen_losses[slot] - pool::loss(members.values[Member::Chosen as usize][slot], value);
        }
        self.pool.learn(&losses);
        self.calibration.learn(&forecast, bins);
        let (recall, near) = (&self.recall, near_losses(&self.pool));
        let rotation = (self.rotation.days() as i32, FAR_ROTATION_DAYS);
        let recalled = |cut| RecalledDays::new(recall, rotation, day, cut);
        self.outlook.judge(day, bins, &self.season, &near, recalled);
        let weekday = day.weekday();
        self.all.learn(weekday, bins, &members.all);
        self.recent.learn(weekday, bins, &members.recent);
        let mut residuals = [0.0; SLOTS];
        for (slot, value) in bins.seen() {
            residuals[slot] = value - clip(members.all.weekday[slot / 2]);
        }
        self.rotation.learn(day, &residuals);
        self.learn_alike(kind_of_day(weekday), bins);
        self.add(day, bins);
        self.make_smooth();
        let turns = Outlook::turns(last, day, self.season.first);
        if turns.contains(&true) {
            let profile = self.profile(chosen);
            self.outlook.keep(turns, day, &profile);
        }
        Some(forecast)
    }

    fn add(&mut self, day: LocalDay, bins: &DayBins) {
        let (sum, number) = bins.seen().fold((0.0, 0.0), |(sum, number), (_, value)| (sum + value, number + 1.0));
        self.sum += sum;
        self.bins += number;
        self.season.learn(day, sum, number);
        self.recall.learn(day, bins);
    }

    /// Adds the bins of a day that is not the newest.
    fn add_late(&mut self, day: LocalDay, bins: &DayBins) {
        let age_days = self.recall.last().map_or(0.0, |last| f64::from(last.0) - f64::from(day.0));
        for table in [&mut self.all, &mut self.recent] {
            table.add(day.weekday(), bins, table.weight_at_age(age_days));
        }
        self.add(day, bins);
        self.make_smooth();
    }

    /// Ages the learned data by the days without bins between two days.
    fn pass(&mut self, last: LocalDay, day: LocalDay) {
        let days = i64::from(day.0) - i64::from(last.0) - 1;
        if days > 0 {
            self.all.pass(days as f64);
            self.recent.pass(days as f64);
        }
        // `day` itself ages the days of its kind too, in `learn_alike`.
        for kind in 0..2 {
            let of_kind = (1..=days.min(4 * 7))
                .filter(|back| kind_of_day(LocalDay(day.0.saturating_sub(*back as i32)).weekday()) == kind);
            let factor = libm::pow(ALIKE_KEPT, of_kind.count() as f64) as f32;
            let numbers = self.alike.sums[kind].iter_mut().chain(&mut self.alike.bins[kind]);
            numbers.for_each(|number| *number *= factor);
        }
    }

    fn learn_alike(&mut self, kind: usize, bins: &DayBins) {
        let (sums, numbers) = (&mut self.alike.sums[kind], &mut self.alike.bins[kind]);
        sums.iter_mut().chain(numbers.iter_mut()).for_each(|number| *number *= ALIKE_KEPT as f32);
        for (slot, value) in bins.seen() {
            sums[slot] += value as f32;
            numbers[slot] += 1.0;
            self.alike.last[kind][slot] = value as f32;
        }
    }

    /// Computes the smooth table again where that is due. When it is due depends on the number of bins alone.
    fn make_smooth(&mut self) {
        self.known = equivalent_bins(&self.all.bins_by_kind());
        let needed = self.known.as_flattened().iter().any(|&bins| bins < SMOOTH_BINS);
        if !needed {
            (self.smooth, self.smooth_bins) = (None, 0.0);
        } else if self.smooth.is_none() || self.bins >= self.smooth_bins * (1.0 + SMOOTH_GROWTH) {
            self.smooth = Some(smooth_table(&self.all));
            self.smooth_bins = self.bins;
        }
    }

    /// The forecasts of the members for the week after the last day.
    fn profile(&self, chosen: &dyn TemporalModel) -> Profile {
        let mean = self.mean();
        let mixed = |table: &WeekTable, share: f64| {
            let (kinds, mut weekdays) = table.week(mean);
            for (weekday, hours) in weekdays.iter_mut().enumerate() {
                let of_kind = &kinds[kind_of_day(weekday)];
                hours.iter_mut().zip(of_kind).for_each(|(value, kind)| *value += share * (kind - *value));
            }
            weekdays
        };
        let next = self.recall.last().map_or(0, |last| last.0.saturating_add(1));
        let mut of_chosen = [[0.0; HOURS]; 7];
        for ahead in 0..7 {
            let day = LocalDay(next.saturating_add(ahead));
            for (hour, value) in of_chosen[day.weekday()].iter_mut().enumerate() {
                let at = |half: i64| {
                    chosen.predict(forecast::civil_moment(day, (2 * hour as i64 + half) * SLOT_NANOS + SLOT_NANOS / 2))
                };
                *value = 0.5 * (at(0) + at(1));
            }
        }
        Profile {
            mean,
            week: mixed(&self.all, self.pool.share(Member::Kind, Member::Weekday)),
            recent: mixed(&self.recent, self.pool.share(Member::RecentKind, Member::RecentWeekday)),
            chosen: of_chosen,
            rhythm: self.season.rhythm,
        }
    }
}

/// The largest number of parts into which a bin is split to score a model with finer time steps.
const PARTS_JUDGED: usize = 6;

/// Successive readings of one bin, with the prediction of the chosen model at the middle one.
struct BinPart {
    slot: usize,
    number: f64,
    mean: f64,
    /// Σ (value - mean)².
    scatter: f64,
    chosen: f64,
}

impl BinPart {
    /// The squared error of a forecast, summed over the readings.
    fn squared_error(&self, forecast: &DayForecast) -> f64 {
        let predicted = forecast.with_chosen(self.slot, self.chosen);
        self.number * square(predicted - self.mean) + self.scatter
    }
}

/// At most [`PARTS_JUDGED`] parts of each bin. `samples`: the readings of one day, in order of time.
fn bin_parts(samples: &[Sample], model: &dyn TemporalModel) -> Vec<BinPart> {
    let slot = |sample: &Sample| slot_at(sample.civil_nanos());
    let bins = samples.chunk_by(|one, next| slot(one) == slot(next));
    let parts = bins.flat_map(|bin| bin.chunks(bin.len().div_ceil(PARTS_JUDGED)));
    let part = |part: &[Sample]| {
        let middle = part.get(part.len() / 2)?;
        let number = part.len() as f64;
        let mean = part.iter().map(|sample| sample.value).sum::<f64>() / number;
        let scatter = part.iter().map(|sample| square(sample.value - mean)).sum();
        Some(BinPart { slot: slot(middle), number, mean, scatter, chosen: model.predict(middle.moment()) })
    };
    parts.filter_map(part).collect()
}

/// The loss of the chosen model in each bin of a day: the mean over the parts of the bin.
fn bin_losses(parts: &[BinPart]) -> [f64; SLOTS] {
    let mut losses = [0.0; SLOTS];
    for bin in parts.chunk_by(|one, next| one.slot == next.slot) {
        let number: f64 = bin.iter().map(|part| part.number).sum();
        let mean = bin.iter().map(|part| part.number * part.mean).sum::<f64>() / number;
        // Differences between the parts of a bin do not count as errors of the model.
        let loss = |part: &BinPart| part.number * (pool::loss(part.chosen, part.mean) - square(part.mean - mean));
        if let Some(first) = bin.first() {
            losses[first.slot] = bin.iter().map(loss).sum::<f64>() / number;
        }
    }
    losses
}
