//! A model kind with all its parameters, ready to be trained.
//!
//! Names of models and parameters are those of the command line and the protocols. Invariant: a parameter set can be
//! trained on any readings in the model's range of values; a parameter out of range is refused before data is read.

use tidemap_model::{
    Accumulator, ORDER_MAX, Periodicities, Sample, SpectralModel, StateKind,
    models::{
        COUNT_BIN_NANOS, Calibrated, CalibratedOptions, CannotFit, CountRate, HISTOGRAM_PRIOR_READINGS, Histogram,
        HistogramCycle, HistogramSettings, Hypertime, HypertimeMethod, HypertimeOptions, Latest, MarkovChain, Mean,
        Moment, Pergam, PergamOptions, Readings, TemporalModel, UniformSpectral,
    },
    time::{format_duration, parse_duration},
};

/// A trained model.
pub type FittedModel = Box<dyn TemporalModel + Send + Sync>;

/// A kind of model with all its parameters.
#[derive(Clone, Debug)]
pub struct ParameterSet {
    shown: String,
    settings: Settings,
}

#[derive(Clone, Debug)]
enum Settings {
    Mean,
    Latest,
    Persistence,
    Histogram(HistogramSettings),
    Spectral { order: usize, periodicities: Periodicities },
    Uniform { order: usize },
    Pergam(PergamOptions),
    Hypertime { options: HypertimeOptions, periodicities: Periodicities },
    Poisson { periodicities: Periodicities, bin_nanos: i64 },
    Calibrated,
    Average { histogram: HistogramSettings, calibrated_weight: f64 },
}

/// Why the parameters of a model are invalid.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum WrongParameter {
    /// A value cannot be read, or is out of range.
    #[error("{name} has to be {right}")]
    Value { name: &'static str, right: String },
    /// The parameters exclude each other.
    #[error("{0}")]
    Together(String),
}

/// The kinds of models that can be compared: all kinds of the command line except `auto`, and a mean of two of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the guide explains the models of these names")]
pub enum ComparableKind {
    Mean,
    Latest,
    Persistence,
    Histogram,
    Spectral,
    Uniform,
    Pergam,
    HypertimeEm,
    HypertimeKm,
    Poisson,
    Calibrated,
    /// The weighted mean of the calibrated profile and a histogram.
    Average,
}

impl ComparableKind {
    /// All kinds with their names and parameters, in the order of the command line.
    pub const ALL: [(Self, &str, &[&str]); 12] = [
        (Self::Mean, "mean", &[]),
        (Self::Latest, "latest", &[]),
        (Self::Persistence, "persistence", &[]),
        (Self::Histogram, "histogram", &["bins", "cycle", "smoothing_bins", "prior_readings"]),
        (Self::Spectral, "spectral", &["order", "period_base", "period_count"]),
        (Self::Uniform, "uniform", &["order"]),
        (Self::Pergam, "pergam", &["gaussians", "period", "seed"]),
        (Self::HypertimeEm, "hypertime-em", &["clusters", "seed", "period_base", "period_count"]),
        (Self::HypertimeKm, "hypertime-km", &["clusters", "seed", "period_base", "period_count"]),
        (Self::Poisson, "poisson", &["bin", "period_base", "period_count"]),
        (Self::Calibrated, "calibrated", &[]),
        (Self::Average, "average", &["bins", "cycle", "smoothing_bins", "prior_readings", "calibrated_weight"]),
    ];
}

/// Parameters by name, as texts of the protocol.
struct ParameterTexts<'a>(&'a [(&'static str, &'a str)]);

impl ParameterTexts<'_> {
    /// The value of a parameter, or its default if the protocol has none.
    fn get<T>(
        &self,
        name: &'static str,
        default: T,
        right: &str,
        read: impl FnOnce(&str) -> Option<T>,
    ) -> Result<T, WrongParameter> {
        let text = self.0.iter().find(|(other, _)| *other == name).map(|(_, text)| *text);
        let wrong = || WrongParameter::Value { name, right: right.to_owned() };
        text.map_or(Ok(default), |text| read(text).ok_or_else(wrong))
    }

    fn whole(&self, name: &'static str, default: usize, right: &str) -> Result<usize, WrongParameter> {
        self.get(name, default, right, |text| text.parse().ok())
    }

    fn number(&self, name: &'static str, default: f64, right: &str) -> Result<f64, WrongParameter> {
        self.get(name, default, right, |text| text.parse().ok().filter(|number: &f64| number.is_finite()))
    }

    fn duration(&self, name: &'static str, default_nanos: i64) -> Result<i64, WrongParameter> {
        self.get(name, default_nanos, "a duration such as 10m, 1d or 7d", |text| parse_duration(text).ok())
    }

    fn seed(&self) -> Result<u64, WrongParameter> {
        self.get("seed", 0, "a whole number from 0", |text| text.parse().ok())
    }

    fn order(&self) -> Result<usize, WrongParameter> {
        let order = |text: &str| text.parse().ok().filter(|&order: &usize| order <= ORDER_MAX);
        self.get("order", ORDER_MAX, "a whole number from 0 to 15", order)
    }

    fn histogram(&self) -> Result<HistogramSettings, WrongParameter> {
        let cycle = self.get("cycle", HistogramCycle::Day, "day, week or weekend", |text| match text {
            "day" => Some(HistogramCycle::Day),
            "week" => Some(HistogramCycle::Week),
            "weekend" => Some(HistogramCycle::WeekdayWeekend),
            _ => None,
        })?;
        Ok(HistogramSettings {
            cycle,
            bins: self.whole("bins", 24, "a whole number from 1")?,
            smoothing_bins: self.number("smoothing_bins", 0.0, "a number of bins, 0 for none")?,
            prior_readings: self.number("prior_readings", HISTOGRAM_PRIOR_READINGS, "a number from 0")?,
        })
    }

    fn periodicities(&self) -> Result<Periodicities, WrongParameter> {
        const DEFAULT_BASE_NANOS: i64 = 7 * 86_400 * 1_000_000_000;
        let base_nanos = self.duration("period_base", DEFAULT_BASE_NANOS)?;
        let count = self.whole("period_count", 168, "a whole number from 1 to 2048")?;
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        Periodicities::harmonics(base_nanos, count).map_err(|refused| {
            WrongParameter::Together(format!(
                "period_base {} with period_count {count}: {refused}",
                format_duration(base_nanos)
            ))
        })
    }
}

impl ParameterSet {
    /// A kind with some of the parameters that [`ComparableKind::ALL`] lists, and defaults for the others.
    ///
    /// # Errors
    /// [`WrongParameter`] if a value cannot be read or the model refuses it.
    pub fn new(kind: ComparableKind, parameters: &[(&'static str, &str)]) -> Result<Self, WrongParameter> {
        let given = ParameterTexts(parameters);
        let settings = match kind {
            ComparableKind::Mean => Settings::Mean,
            ComparableKind::Latest => Settings::Latest,
            ComparableKind::Persistence => Settings::Persistence,
            ComparableKind::Histogram => Settings::Histogram(given.histogram()?),
            ComparableKind::Average => {
                let right = "a number from 0 (the histogram alone) to 1 (the calibrated profile alone)";
                let weight = |text: &str| text.parse().ok().filter(|weight| (0.0..=1.0).contains(weight));
                let calibrated_weight = given.get("calibrated_weight", 0.5, right, weight)?;
                Settings::Average { histogram: given.histogram()?, calibrated_weight }
            }
            ComparableKind::Spectral => {
                Settings::Spectral { order: given.order()?, periodicities: given.periodicities()? }
            }
            ComparableKind::Uniform => Settings::Uniform { order: given.order()? },
            ComparableKind::Pergam => {
                let usual = PergamOptions::default();
                Settings::Pergam(PergamOptions {
                    gaussians: given.whole("gaussians", usual.gaussians, "a whole number from 1 to 20")?,
                    period_nanos: given.duration("period", usual.period_nanos)?,
                    seed: given.seed()?,
                })
            }
            ComparableKind::HypertimeEm | ComparableKind::HypertimeKm => {
                let usual = HypertimeOptions::default();
                let is_em = kind == ComparableKind::HypertimeEm;
                let options = HypertimeOptions {
                    method: if is_em { HypertimeMethod::Em } else { HypertimeMethod::Km },
                    clusters: given.whole("clusters", usual.clusters, "a whole number from 1 to 50")?,
                    seed: given.seed()?,
                };
                Settings::Hypertime { options, periodicities: given.periodicities()? }
            }
            ComparableKind::Poisson => Settings::Poisson {
                periodicities: given.periodicities()?,
                bin_nanos: given.duration("bin", COUNT_BIN_NANOS)?,
            },
            ComparableKind::Calibrated => Settings::Calibrated,
        };
        let shown: Vec<String> = parameters.iter().map(|(name, text)| format!("{name}={text}")).collect();
        let set = Self { shown: shown.join(" "), settings };
        if matches!(set.settings, Settings::Uniform { .. }) {
            // It needs two readings.
            return Ok(set);
        }
        // Training on one reading makes the model check its parameters.
        let reading = [Sample { utc_nanos: 0, offset_secs: 0, value: 0.5 }];
        match set.fit(&reading, StateKind::Probability) {
            Err(refused @ (CannotFit::Parameter { .. } | CannotFit::Irregular { .. })) => {
                Err(WrongParameter::Together(refused.to_string()))
            }
            Ok(_) | Err(CannotFit::NoReadings | CannotFit::Stop(_)) => Ok(set),
        }
    }

    /// The parameters of the protocol, such as `bins=24 cycle=day`.
    pub fn shown(&self) -> &str {
        &self.shown
    }

    /// Trains the model on the readings of one state, ascending by time.
    ///
    /// # Errors
    /// [`CannotFit`] without readings, or if a value is out of the model's range.
    pub fn fit(&self, samples: &[Sample], kind: StateKind) -> Result<FittedModel, CannotFit> {
        let readings = Readings::new(samples);
        Ok(match &self.settings {
            Settings::Mean => Box::new(Mean::fit(readings)?),
            Settings::Latest => Box::new(Latest::fit(readings)?),
            Settings::Persistence => Box::new(MarkovChain::fit(readings)?),
            Settings::Histogram(settings) => Box::new(Histogram::fit(readings, settings)?),
            Settings::Spectral { order, periodicities } => {
                Box::new(Spectral::fit(samples, kind, *order, periodicities)?)
            }
            Settings::Uniform { order } => Box::new(UniformSpectral::fit(readings, *order)?),
            Settings::Pergam(options) => {
                check_probabilities(samples)?;
                Box::new(Pergam::fit(readings, options)?)
            }
            Settings::Hypertime { options, periodicities } if kind == StateKind::Probability => {
                Box::new(Hypertime::fit(readings, periodicities, options)?)
            }
            Settings::Hypertime { options, periodicities } => {
                Box::new(Hypertime::fit_continuous(readings, periodicities, options)?)
            }
            Settings::Poisson { periodicities, bin_nanos } => {
                Box::new(CountRate::fit_in_bins(readings, periodicities, *bin_nanos)?)
            }
            Settings::Calibrated => Box::new(Calibrated::fit(readings, CalibratedOptions::default())?),
            Settings::Average { histogram, calibrated_weight } => Box::new(Average {
                calibrated: Calibrated::fit(readings, CalibratedOptions::default())?,
                histogram: Histogram::fit(readings, histogram)?,
                calibrated_weight: *calibrated_weight,
            }),
        })
    }
}

fn check_probabilities(samples: &[Sample]) -> Result<(), CannotFit> {
    match samples.iter().find(|sample| !(0.0..=1.0).contains(&sample.value)) {
        Some(sample) => {
            let (parameter, expected) = ("a reading's value", "0 to 1");
            Err(CannotFit::Parameter { parameter, found: sample.value, expected })
        }
        None => Ok(()),
    }
}

/// The weighted mean of two profiles whose errors differ: the calibrated one distinguishes days where they differ for
/// certain, the smoothed histogram has more readings behind each value.
struct Average {
    calibrated: Calibrated,
    histogram: Histogram,
    /// From 0 to 1; the histogram has the rest.
    calibrated_weight: f64,
}

impl TemporalModel for Average {
    fn predict(&self, at: Moment) -> f64 {
        let weight = self.calibrated_weight;
        weight * self.calibrated.predict(at) + (1.0 - weight) * self.histogram.predict(at)
    }
}

/// The spectral model with a fixed order.
struct Spectral {
    model: SpectralModel,
    kind: StateKind,
    order: usize,
    periodicities: Periodicities,
}

impl Spectral {
    fn fit(
        samples: &[Sample],
        kind: StateKind,
        order: usize,
        periodicities: &Periodicities,
    ) -> Result<Self, CannotFit> {
        if samples.is_empty() {
            return Err(CannotFit::NoReadings);
        }
        let mut accumulator = Accumulator::of_kind(kind);
        accumulator.add(periodicities, samples);
        let model = SpectralModel::fit(&accumulator, periodicities);
        Ok(Self { model, kind, order, periodicities: periodicities.clone() })
    }
}

impl TemporalModel for Spectral {
    fn predict(&self, at: Moment) -> f64 {
        self.model.predict_value(self.kind, &self.periodicities, self.order, at.civil_nanos())
    }
}
