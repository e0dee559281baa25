//! What may predict a state better than its spectrum: histograms, and the choice among all, by held-out error.
//!
//! Each is scored on what a local day brought before the day is folded in, as the orders of the spectral model are, with
//! the same fading (T-RO section IV.B). Invariant: the errors of all are over the same observations, so that they can be
//! compared.

use crate::{
    Accumulator, InvalidParts, LocalDay, Periodicities, Persistence, PersistenceParts, Sample, SpectralModel,
    family::{
        ChangeAlarm, ChangeAlarmParts, DependenceSums, HistogramCycle, HourTable, HourTableParts, TemporalModel,
        effective_observations, supported_order,
    },
    order::{KEPT_PER_DAY, OrderCriterion},
};

/// The histograms that are tried: cycle, and bins of the cycle.
pub const HISTOGRAMS: [(HistogramCycle, usize); 3] =
    [(HistogramCycle::Day, 24), (HistogramCycle::WeekdayWeekend, 24), (HistogramCycle::Week, 168)];

/// Another model than the one in force is chosen only where its error is lower than that one's by this factor: what was
/// chosen by a hair today would be dropped by a hair tomorrow.
const CLEARLY_LOWER: f64 = 0.95;

/// An alarm rings for so many days; then what it rang for is history.
const ALARM_DAYS: i32 = 28;

/// The model that predicts a state best so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelChoice {
    /// The spectral model with the order in force; order 0 is the mean.
    #[default]
    Spectral,
    /// The histogram of that number in [`HISTOGRAMS`].
    Histogram(u8),
}

/// What is known of a state apart from its spectrum.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alternatives {
    hours: HourTable,
    parts: Errors,
    alarm: ChangeAlarm,
    /// How the readings that were folded in follow each other.
    succession: Persistence,
    /// Components that noise would not show as well.
    supported: u8,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Errors {
    /// Faded sum of errors of the spectral model with its best order.
    spectral: f64,
    /// The same of each histogram.
    histograms: [f64; HISTOGRAMS.len()],
    last_day: Option<LocalDay>,
    folded_day: Option<LocalDay>,
    choice: ModelChoice,
}

/// What [`Alternatives`] consist of, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct AlternativesParts {
    /// What was read in each hour of the week.
    pub hours: HourTableParts,
    /// Faded sums of errors: of the spectral model, then of each of [`HISTOGRAMS`].
    pub error_sums: Vec<f64>,
    /// The last local day that was scored.
    pub last_day: Option<LocalDay>,
    /// The last local day that was folded in.
    pub folded_day: Option<LocalDay>,
    /// The model in force: 0 the spectral model, else the number of the histogram, from 1.
    pub choice: u8,
    /// The change alarm.
    pub alarm: ChangeAlarmParts,
    /// How the readings that were folded in follow each other.
    pub succession: PersistenceParts,
    /// Components of the spectral model that noise would not show as well.
    pub supported: u8,
}

impl Alternatives {
    /// What was read in each hour of the week.
    pub fn hours(&self) -> &HourTable {
        &self.hours
    }

    /// The model in force.
    pub fn choice(&self) -> ModelChoice {
        self.parts.choice
    }

    /// Faded sums of errors: of the spectral model with its best order, then of each of [`HISTOGRAMS`].
    pub fn error_sums(&self) -> [f64; 1 + HISTOGRAMS.len()] {
        let [day, kind_of_day, week] = self.parts.histograms;
        [self.parts.spectral, day, kind_of_day, week]
    }

    /// Whether recent errors depart from their history.
    pub fn alarm(&self) -> &ChangeAlarm {
        &self.alarm
    }

    /// How many components of the spectral model are such as noise would not show as well.
    pub fn supported_order(&self) -> usize {
        usize::from(self.supported)
    }

    /// The histogram of a number in [`HISTOGRAMS`]; `None` where nothing was read.
    pub(crate) fn histogram(&self, number: u8) -> Option<crate::family::Histogram> {
        let &(cycle, bins) = HISTOGRAMS.get(usize::from(number))?;
        self.hours.histogram(cycle, bins)
    }

    /// Scores the histograms on a day's newer samples and chooses. `spectral_day`: the error by the criterion of the order
    /// that is now best; `spectral_sum`: its faded sum, the day included; `spectral_squared`: the squared error of the
    /// order that was in force. Gives the squared error of the model that was in force.
    pub(super) fn score(
        &mut self,
        day: LocalDay,
        criterion: OrderCriterion,
        newer: &[Sample],
        (spectral_day, spectral_sum): (f64, f64),
        spectral_squared: f64,
    ) -> f64 {
        let mut errors = [0.0; HISTOGRAMS.len()];
        let mut squared = [0.0; HISTOGRAMS.len()];
        for (number, (error, squared)) in errors.iter_mut().zip(&mut squared).enumerate() {
            // There are fewer than 256.
            let Some(histogram) = self.histogram(number as u8) else { return spectral_squared };
            for sample in newer {
                let predicted = histogram.predict(sample.moment());
                let difference = predicted - sample.value;
                *squared += difference * difference;
                *error += match criterion {
                    OrderCriterion::SquaredError => difference * difference,
                    OrderCriterion::ZeroOne => f64::from(u8::from((predicted >= 0.5) != (sample.value >= 0.5))),
                };
            }
        }
        let squared_in_force = match self.parts.choice {
            ModelChoice::Spectral => spectral_squared,
            ModelChoice::Histogram(number) => squared.get(usize::from(number)).copied().unwrap_or(spectral_squared),
        };
        self.watch(day, squared_in_force / newer.len().max(1) as f64, newer.len() as u64);
        let elapsed_days = self.parts.last_day.map(|last| (i64::from(day.0) - i64::from(last.0)).max(0));
        for (sum, error) in self.parts.histograms.iter_mut().zip(errors) {
            *sum = match elapsed_days {
                Some(elapsed_days) => *sum * KEPT_PER_DAY.powf(elapsed_days as f64) + error,
                // The spectral model may have been scored for long: all begin with what it has.
                None => spectral_sum - spectral_day + error,
            };
        }
        self.parts.spectral = spectral_sum;
        self.parts.last_day = Some(self.parts.last_day.map_or(day, |last| last.max(day)));
        self.choose();
        squared_in_force
    }

    fn watch(&mut self, day: LocalDay, mse: f64, observations: u64) {
        if self.alarm.rang_on().is_some_and(|rang| day.0 - rang.0 >= ALARM_DAYS) {
            self.alarm.reset();
        }
        self.alarm.observe(day, mse, observations);
    }

    fn choose(&mut self) {
        let sum_of = |choice: ModelChoice| match choice {
            ModelChoice::Spectral => self.parts.spectral,
            ModelChoice::Histogram(number) => {
                self.parts.histograms.get(usize::from(number)).copied().unwrap_or(f64::INFINITY)
            }
        };
        let all =
            [ModelChoice::Spectral].into_iter().chain((0..HISTOGRAMS.len()).map(|n| ModelChoice::Histogram(n as u8)));
        let mut best = self.parts.choice;
        for choice in all {
            let bar = if best == self.parts.choice { CLEARLY_LOWER * sum_of(best) } else { sum_of(best) };
            if sum_of(choice) < bar {
                best = choice;
            }
        }
        self.parts.choice = best;
    }

    /// The last local day that was folded in.
    pub(super) fn folded_day(&self) -> Option<LocalDay> {
        self.parts.folded_day
    }

    /// Folds a day in. What it holds must not be split over two calls within an hour, or days seem to differ more.
    pub(super) fn add(&mut self, day: LocalDay, samples: &[Sample]) {
        self.hours.add(samples);
        for sample in samples {
            self.succession.observe(sample.utc_nanos, sample.value);
        }
        self.parts.folded_day = self.parts.folded_day.max(Some(day));
    }

    /// Judges which components of a new fit are supported.
    pub(super) fn support(&mut self, model: &SpectralModel, periodicities: &Periodicities, folded: &Accumulator) {
        let succession = self.succession.to_parts();
        let effective = effective_observations(&DependenceSums {
            pairs: succession.pairs,
            change_rate_sum: succession.change_rate_sum,
            span_secs: folded.span_nanos() as f64 / 1e9,
            mean: folded.mean(),
            observed_hours: Some(self.hours.observed_hours()),
        });
        // What is forgotten supports nothing.
        let remembered = folded.weight() / (folded.observations() as f64).max(1.0);
        // At most 15.
        self.supported = supported_order(model, periodicities, effective * remembered) as u8;
    }

    /// Folds an older day in, which counts `factor` times as much as it would today.
    pub(super) fn add_late(&mut self, samples: &[Sample], factor: f64) {
        let mut late = HourTable::default();
        late.add(samples);
        late.scale(factor);
        self.hours.merge(&late);
    }

    /// Makes what was folded in so far count less.
    pub(super) fn fade(&mut self, factor: f64) {
        self.hours.scale(factor);
    }

    /// What to store.
    pub fn to_parts(&self) -> AlternativesParts {
        AlternativesParts {
            hours: self.hours.to_parts(),
            error_sums: self.error_sums().to_vec(),
            last_day: self.parts.last_day,
            folded_day: self.parts.folded_day,
            choice: match self.parts.choice {
                ModelChoice::Spectral => 0,
                ModelChoice::Histogram(number) => number + 1,
            },
            alarm: self.alarm.to_parts(),
            succession: self.succession.to_parts(),
            supported: self.supported,
        }
    }

    /// From what was stored.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts(parts: AlternativesParts) -> Result<Alternatives, InvalidParts> {
        let &[spectral, day, kind_of_day, week] = parts.error_sums.as_slice() else {
            return Err(InvalidParts::OutOfRange {
                field: "number of error sums",
                found: parts.error_sums.len() as f64,
            });
        };
        for &sum in &parts.error_sums {
            InvalidParts::check("error sum", sum, 0.0..=f64::MAX)?;
        }
        let choice = match parts.choice {
            0 => ModelChoice::Spectral,
            number if usize::from(number) <= HISTOGRAMS.len() => ModelChoice::Histogram(number - 1),
            number => return Err(InvalidParts::OutOfRange { field: "chosen model", found: f64::from(number) }),
        };
        Ok(Alternatives {
            hours: HourTable::from_parts(parts.hours)?,
            parts: Errors {
                spectral,
                histograms: [day, kind_of_day, week],
                last_day: parts.last_day,
                folded_day: parts.folded_day,
                choice,
            },
            alarm: ChangeAlarm::from_parts(parts.alarm)?,
            succession: Persistence::from_parts(parts.succession)?,
            supported: parts.supported,
        })
    }
}
