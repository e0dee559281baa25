//! Alternatives to the spectral model: histograms and models that are trained on readings, and the choice among all by
//! held-out error.
//!
//! Each model is scored on a local day before the day is learned, as the orders of the spectral model are, with the
//! same fading (T-RO section IV.B). Histograms follow from sums of the training data; the others are trained outside,
//! on the readings themselves, and handed in from time to time. Invariant: the errors of all models are over the same
//! observations, so that they can be compared, and no model is scored on its training data.

use std::sync::Arc;

use crate::{
    Accumulator, AnyEnsemble, Gaps, LocalDay, ORDER_MAX, Periodicities, Persistence, Sample, SpectralModel, StateKind,
    catalogue::{EnabledModels, HISTOGRAMS, ModelKind, TRAINED_AT_NIGHT, TrainedModel},
    models::{
        ChangeAlarm, DependenceSums, Histogram, HourTable, Moment, OrderGains, TemporalModel,
        half_square_of_probabilities, half_square_of_values, supported_order_of,
    },
    order::{OrderCriterion, kept},
};

mod combination;
mod fields;
mod hourly;
mod parts;
#[cfg(test)]
mod tests;

pub(super) use combination::SpectralAtOrder;
pub use combination::{ChosenMember, Combination};
pub use parts::{AlternativesParts, TrainingRecordParts};

/// A model's prediction for the time of a sample.
pub(super) type SampleForecast<'a> = &'a dyn Fn(&Sample) -> f64;

/// A model as it was last trained on readings.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TrainingRecord {
    /// Shared: it is a large part of a state, and most updates leave it as it is.
    pub(super) model: Arc<TrainedModel>,
    /// The last local day that it was trained on.
    pub(super) day: LocalDay,
    /// Faded sum of errors, of this model and those before it; `None` before the first day that it was scored on.
    pub(super) error: Option<f64>,
}

/// The rules of an update of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UpdateRules {
    /// The error that decides between orders and models.
    pub criterion: OrderCriterion,
    /// An observation of this many local days ago counts half, above 0; `None`: all count alike, however old.
    pub half_life_days: Option<f64>,
    /// The models to choose among.
    pub models: EnabledModels,
}

impl From<OrderCriterion> for UpdateRules {
    fn from(criterion: OrderCriterion) -> UpdateRules {
        UpdateRules { criterion, ..UpdateRules::default() }
    }
}

/// Hysteresis: another model is chosen only if its error is lower than that of the model in force by this factor.
pub(super) const CLEARLY_LOWER: f64 = 0.95;

/// Number of days for which an alarm rings; then the change counts as history.
pub(super) const ALARM_DAYS: i32 = 28;

/// The days that have triggered the alarm belong to the new routine: at least this many before the day on which it
/// rang.
const RINGING_DAYS: i32 = 3;

/// The factor on errors from before a change of routine: as if they were twenty days older.
pub(super) const KEPT_AT_CHANGE: f64 = 0.25;

/// Errors that differ by less than this share of the squared values are equal.
const ROUNDING: f64 = 1e-20;

/// Models are trained on readings first after this many observed local days, and again every this many local days.
const RETRAIN_DAYS: u32 = 7;

/// Cheap models are trained first after this many observed local days, then daily until [`RETRAIN_DAYS`]: a short
/// record can already choose among them.
const EARLY_TRAINING_DAYS: u32 = 3;

/// The model in force, if it is not the spectral model alone.
#[derive(Clone, Debug, PartialEq)]
pub enum ActiveModel<'a> {
    /// A histogram of the training data.
    Histogram(Histogram),
    /// A model that was trained on readings.
    Trained(&'a TrainedModel),
    /// Several models together.
    Combination(Combination<'a>),
}

impl ActiveModel<'_> {
    /// Whether it can predict a moment: a histogram that has no readings of that hour, nor of the coarser intervals
    /// around it, cannot; then the spectral model predicts.
    pub fn covers(&self, at: Moment) -> bool {
        match self {
            ActiveModel::Histogram(model) => model.has_readings_near(at),
            ActiveModel::Trained(_) | ActiveModel::Combination(_) => true,
        }
    }
}

impl TemporalModel for ActiveModel<'_> {
    fn predict(&self, at: Moment) -> f64 {
        match self {
            ActiveModel::Histogram(model) => model.predict(at),
            ActiveModel::Trained(model) => model.predict(at),
            ActiveModel::Combination(model) => model.predict(at),
        }
    }
}

/// The alternatives to the spectral model of a state, with their errors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alternatives {
    hours: HourTable,
    parts: Errors,
    alarm: ChangeAlarm,
    /// Persistence of the learned readings.
    succession: Persistence,
    /// The times between the learned readings.
    gaps: Gaps,
    /// Sum of |change of value| between the learned readings.
    changes: f64,
    /// Number of components that noise would not show.
    supported: u8,
    /// The gains of the choice of orders, day by day.
    gains: OrderGains,
    /// Local days learned, without late ones.
    days: u32,
    /// The first local day of the present routine, by the change alarm.
    since: Option<LocalDay>,
    /// The ensemble, which predicts where it is enabled. Shared with readers.
    ensemble: Option<Arc<AnyEnsemble>>,
    /// The models that were trained on readings, by their places in [`TRAINED_AT_NIGHT`].
    trained: [Option<TrainingRecord>; TRAINED_AT_NIGHT.len()],
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Errors {
    /// Faded sum of errors of the spectral model with its best order.
    spectral: f64,
    /// Faded sum of errors of each histogram; `None` where they are not tried.
    histograms: Option<[f64; HISTOGRAMS.len()]>,
    last_day: Option<LocalDay>,
    learned_day: Option<LocalDay>,
    /// The model that has predicted best so far: [`ModelKind::Spectral`] at the order in force, where order 0 is the
    /// mean, one of [`HISTOGRAMS`], or one of [`TRAINED_AT_NIGHT`].
    choice: ModelKind,
}

impl Default for Errors {
    fn default() -> Errors {
        Errors { spectral: 0.0, histograms: None, last_day: None, learned_day: None, choice: ModelKind::Spectral }
    }
}

/// The error of one model on the samples of a day.
#[derive(Clone, Copy, Debug, Default)]
struct DayError {
    by_criterion: f64,
    squared: f64,
}

impl DayError {
    fn of(model: &impl TemporalModel, criterion: OrderCriterion, samples: &[Sample]) -> DayError {
        let mut error = DayError::default();
        for sample in samples {
            error.add(model.predict(sample.moment()), criterion, sample.value);
        }
        error
    }

    fn add(&mut self, predicted: f64, criterion: OrderCriterion, value: f64) {
        self.squared += squared(predicted, value);
        self.by_criterion += by_criterion(criterion, predicted, value);
    }
}

fn squared(predicted: f64, value: f64) -> f64 {
    (predicted - value) * (predicted - value)
}

fn by_criterion(criterion: OrderCriterion, predicted: f64, value: f64) -> f64 {
    match criterion {
        OrderCriterion::SquaredError => squared(predicted, value),
        OrderCriterion::ZeroOne => f64::from(u8::from((predicted >= 0.5) != (value >= 0.5))),
    }
}

impl Alternatives {
    /// The readings by hour of the week.
    pub fn hours(&self) -> &HourTable {
        &self.hours
    }

    /// The model in force: the spectral one, one of [`HISTOGRAMS`] or one of [`TRAINED_AT_NIGHT`].
    pub fn choice(&self) -> ModelKind {
        self.parts.choice
    }

    /// Puts a model in force, which must be among [`Alternatives::error_sums`].
    pub(super) fn set_choice(&mut self, choice: ModelKind) {
        self.parts.choice = choice;
    }

    /// Untrained alternatives with these models enabled.
    pub(super) fn new(kind: StateKind, models: EnabledModels) -> Alternatives {
        let ensemble = models.has_ensemble().then(|| Arc::new(AnyEnsemble::new(kind)));
        let parts = Errors { histograms: models.has_histograms().then(Default::default), ..Errors::default() };
        Alternatives { parts, ensemble, ..Alternatives::default() }
    }

    /// The ensemble of the models; `None` where it is not enabled.
    pub fn ensemble(&self) -> Option<&AnyEnsemble> {
        self.ensemble.as_deref()
    }

    /// The ensemble, for changes.
    pub(super) fn ensemble_mut(&mut self) -> &mut Option<Arc<AnyEnsemble>> {
        &mut self.ensemble
    }

    /// Faded sums of errors of all models that are tried: of the spectral model with its best order, of each of
    /// [`HISTOGRAMS`], and of each of [`TRAINED_AT_NIGHT`] once it was scored.
    pub fn error_sums(&self) -> impl Iterator<Item = (ModelKind, f64)> {
        let histograms = HISTOGRAMS.into_iter().zip(self.parts.histograms.into_iter().flatten());
        let trained = TRAINED_AT_NIGHT.into_iter().zip(&self.trained);
        let trained = trained.filter_map(|(kind, record)| Some((kind, record.as_ref()?.error?)));
        std::iter::once((ModelKind::Spectral, self.parts.spectral)).chain(histograms).chain(trained)
    }

    fn record(&self, kind: ModelKind) -> Option<&TrainingRecord> {
        self.trained.get(kind.place_at_night()?)?.as_ref()
    }

    /// The model of the given kind and the last local day that it was trained on; `None` before its first training.
    pub fn trained(&self, kind: ModelKind) -> Option<(&TrainedModel, LocalDay)> {
        self.record(kind).map(|record| (&*record.model, record.day))
    }

    /// Whether the model of the given kind is due for training; never for one that updates do not train.
    pub(super) fn is_training_due(&self, kind: ModelKind) -> bool {
        let Some(folded) = self.parts.learned_day.filter(|_| kind.place_at_night().is_some()) else { return false };
        match self.record(kind) {
            None => self.days >= if kind.is_cheap() { EARLY_TRAINING_DAYS } else { RETRAIN_DAYS },
            Some(record) => {
                let age_days = i64::from(folded.0) - i64::from(record.day.0);
                (kind.is_cheap() && self.days <= RETRAIN_DAYS && age_days >= 1)
                    || age_days >= i64::from(RETRAIN_DAYS)
                    || self.alarm.alarm_day().is_some_and(|alarm_day| alarm_day > record.day)
            }
        }
    }

    /// Takes a newly trained model of a kind, which is scored from the next day on; the errors of earlier ones of its
    /// kind stay. A kind that updates do not train changes nothing.
    pub(super) fn set_trained(&mut self, kind: ModelKind, model: TrainedModel, day: LocalDay) {
        if let Some(record) = kind.place_at_night().and_then(|place| self.trained.get_mut(place)) {
            let error = record.as_ref().and_then(|earlier| earlier.error);
            *record = Some(TrainingRecord { model: Arc::new(model), day, error });
        }
    }

    /// A copy without the trained models that are not in force.
    pub(super) fn published(&self) -> Alternatives {
        let weights = self.weights();
        let answers = |kind| weights.iter().any(|(choice, _)| *choice == kind);
        let mut published = self.clone();
        for (kind, record) in TRAINED_AT_NIGHT.into_iter().zip(&mut published.trained) {
            *record = record.take().filter(|_| answers(kind));
        }
        // A model that is not in force may still affect the weights of the others.
        if published.weights() == weights { published } else { self.clone() }
    }

    /// Removes models that are not enabled.
    fn restrict(&mut self, models: EnabledModels) {
        self.ensemble = self.ensemble.take().filter(|_| models.has_ensemble());
        self.parts.histograms = self.parts.histograms.filter(|_| models.has_histograms());
        for (kind, record) in TRAINED_AT_NIGHT.into_iter().zip(&mut self.trained) {
            *record = record.take().filter(|_| models.has(kind));
        }
        if !models.has(self.parts.choice) {
            self.parts.choice = ModelKind::Spectral;
        }
    }

    /// The change alarm, which rings when recent errors depart from earlier ones.
    pub fn alarm(&self) -> &ChangeAlarm {
        &self.alarm
    }

    /// Number of supported components of the spectral model: those that noise would not show, or all where the choice
    /// of orders has made predictions better day after day.
    pub fn supported_order(&self) -> usize {
        if self.gains.is_significant() { ORDER_MAX } else { usize::from(self.supported) }
    }

    /// The times between the learned readings.
    pub fn gaps(&self) -> &Gaps {
        &self.gaps
    }

    /// Records the gain on a day of the order that was best before the day.
    pub(super) fn record_gain(&mut self, order: usize, squared_errors: &[f64; ORDER_MAX + 1], scored: u64) {
        self.gains.record(order, squared_errors, scored);
    }

    /// A histogram of the learned readings; `None` where there are no readings, and for another kind of model.
    fn histogram(&self, kind: ModelKind) -> Option<Histogram> {
        let (cycle, bins) = kind.histogram()?;
        self.hours.histogram(cycle, bins)
    }

    /// Scores the enabled models on a day's newer samples and chooses. `spectral_day`: the error by the criterion of
    /// the order that is now best; `spectral_sum`: its faded sum, the day included; `spectral_squared`: the squared
    /// error of the order that was in force, and the mean squared error of a day that counts as 1 for the alarm: for
    /// values that are no probabilities, their variance. `combined`: the squared error of the combined models, if
    /// several were in force; `spectral_of`: the prediction of the spectral model that was in force, which histograms
    /// use where they have no readings. Returns the squared error of the models in force.
    pub(super) fn score(
        &mut self,
        day: LocalDay,
        rules: UpdateRules,
        newer: &[Sample],
        (spectral_day, spectral_sum): (f64, f64),
        (spectral_squared, unit): (f64, f64),
        (combined, spectral_of): (Option<f64>, SampleForecast<'_>),
    ) -> f64 {
        let criterion = rules.criterion;
        self.restrict(rules.models);
        let of_day = if rules.models.has_histograms() {
            let Some(of_day) = self.score_histograms(criterion, newer, spectral_of) else {
                return combined.unwrap_or(spectral_squared);
            };
            of_day
        } else {
            [DayError::default(); HISTOGRAMS.len()]
        };
        let error = |record: &Option<TrainingRecord>| {
            record.as_ref().map(|record| DayError::of(&*record.model, criterion, newer))
        };
        let trained = self.trained.each_ref().map(error);
        let choice = self.parts.choice;
        let histogram = HISTOGRAMS.iter().zip(&of_day).find(|(kind, _)| **kind == choice).map(|(_, error)| *error);
        let in_force = histogram.or_else(|| trained.get(choice.place_at_night()?).copied().flatten());
        let alone = in_force.map_or(spectral_squared, |error| error.squared);
        let squared_in_force = combined.unwrap_or(alone);
        self.watch(day, squared_in_force / newer.len().max(1) as f64 / unit, newer.len() as u64);
        let kept = self.parts.last_day.map(|last| kept(last, day));
        // The spectral model may have been scored for many days. So the sums of histograms begin with its sum, and
        // those of trained models with the sum of the model in force: from then on they are compared from an equal
        // start.
        let before_spectral = spectral_sum - spectral_day;
        let faded = |sum: f64| kept.map(|kept| sum * kept);
        let sum_in_force = match self.parts.choice {
            ModelKind::Spectral => None,
            choice => self.error_sums().find(|(other, _)| *other == choice).map(|(_, sum)| sum),
        };
        let begins = sum_in_force.and_then(faded).unwrap_or(before_spectral);
        if rules.models.has_histograms() {
            let sums = self.parts.histograms.map_or([None; HISTOGRAMS.len()], |sums| sums.map(faded));
            let mut sums = sums.map(|sum| sum.unwrap_or(before_spectral));
            sums.iter_mut().zip(of_day).for_each(|(sum, error)| *sum += error.by_criterion);
            self.parts.histograms = Some(sums);
        }
        for (record, error) in self.trained.iter_mut().zip(trained) {
            if let (Some(record), Some(error)) = (record, error) {
                record.error = Some(record.error.and_then(faded).unwrap_or(begins) + error.by_criterion);
            }
        }
        self.parts.spectral = spectral_sum;
        self.parts.last_day = Some(self.parts.last_day.map_or(day, |last| last.max(day)));
        self.choose(newer.iter().map(|sample| ROUNDING * sample.value * sample.value).sum());
        squared_in_force
    }

    fn watch(&mut self, day: LocalDay, mse: f64, observations: u64) {
        if self.alarm.alarm_day().is_some_and(|alarm_day| day.0 - alarm_day.0 >= ALARM_DAYS) {
            self.alarm.reset();
        }
        let was_ringing = self.alarm.is_ringing();
        if self.alarm.observe(day, mse, observations) && !was_ringing {
            self.since = Some(LocalDay(day.0.saturating_sub(RINGING_DAYS)));
        }
    }

    /// Lowers the weight of the errors recorded so far, because they are of another routine. Returns the factor.
    pub(super) fn discount_errors(&mut self) -> f64 {
        self.parts.spectral *= KEPT_AT_CHANGE;
        self.gains.fade(KEPT_AT_CHANGE);
        self.parts.histograms.iter_mut().flatten().for_each(|sum| *sum *= KEPT_AT_CHANGE);
        let sums = self.trained.iter_mut().flatten().filter_map(|record| record.error.as_mut());
        sums.for_each(|sum| *sum *= KEPT_AT_CHANGE);
        KEPT_AT_CHANGE
    }

    /// The first local day whose readings are worth training on: since the change alarm last rang, once seven days have
    /// passed. `None`: all are.
    pub fn training_since(&self) -> Option<LocalDay> {
        let folded = i64::from(self.parts.learned_day?.0);
        self.since.filter(|since| folded - i64::from(since.0) + 1 >= i64::from(RETRAIN_DAYS))
    }

    /// Puts the model with the lowest error in force, with hysteresis ([`CLEARLY_LOWER`]). Errors that differ by
    /// `rounding` or less count as equal.
    fn choose(&mut self, rounding: f64) {
        let sum_of = |wanted: ModelKind| {
            self.error_sums().find(|(choice, _)| *choice == wanted).map_or(f64::INFINITY, |(_, sum)| sum)
        };
        let mut best = self.parts.choice;
        for (choice, sum) in self.error_sums() {
            let bar = if best == self.parts.choice { CLEARLY_LOWER * sum_of(best) } else { sum_of(best) };
            if sum < bar - rounding {
                best = choice;
            }
        }
        self.parts.choice = best;
    }

    /// The last learned local day.
    pub fn learned_day(&self) -> Option<LocalDay> {
        self.parts.learned_day
    }

    /// Learns a day. A call must not split an hour, or days would seem to differ more.
    pub(super) fn add(&mut self, day: LocalDay, samples: &[Sample]) {
        self.hours.add(samples);
        for sample in samples {
            if let Some((last_nanos, last_value)) = self.succession.last()
                && sample.utc_nanos > last_nanos
            {
                self.gaps.observe(sample.utc_nanos.abs_diff(last_nanos));
                self.changes += (sample.value - last_value).abs();
            }
            self.succession.observe(sample.utc_nanos, sample.value);
        }
        if self.parts.learned_day.is_none_or(|last| day > last) {
            self.parts.learned_day = Some(day);
            self.days = self.days.saturating_add(1);
        }
    }

    /// Determines which components of a newly trained model are supported.
    pub(super) fn support(&mut self, model: &SpectralModel, periodicities: &Periodicities, folded: &Accumulator) {
        let succession = self.succession.to_parts();
        let sums = DependenceSums {
            pairs: succession.pairs,
            change_rate_sum: succession.change_rate_sum,
            span_secs: folded.span_nanos() as f64 / 1e9,
            mean: folded.mean(),
            observed_hours: self.hours.observed_hours(),
            changes: self.changes,
        };
        // Forgotten data supports nothing.
        let remembered = folded.weight() / (folded.observations() as f64).max(1.0);
        let spread: (fn(f64) -> f64, f64) = match folded.kind() {
            StateKind::Probability => (half_square_of_probabilities, model.mean() * (1.0 - model.mean())),
            _ => (half_square_of_values, folded.variance()),
        };
        let supported = supported_order_of(model, periodicities, &sums, spread, remembered);
        // At most 15.
        self.supported = supported as u8;
    }

    /// Learns an older day with the weight `factor`; a new day has the weight 1.
    pub(super) fn add_late(&mut self, samples: &[Sample], factor: f64) {
        let mut late = HourTable::default();
        late.add(samples);
        late.scale(factor);
        self.hours.merge(&late);
    }

    /// Forgetting: lowers the weight of all data learned so far.
    pub(super) fn fade(&mut self, factor: f64) {
        self.hours.scale(factor);
        self.gains.fade(factor);
    }
}
