//! A model with parameters by name, as protocols of experiments and the Python package give them.
//!
//! Invariant: a parameter set can be trained on any readings in the model's range of values; a parameter out of range
//! is refused before data is read.

use super::{ModelKind, TrainedModel, TrainingOptions};
use crate::{
    ORDER_MAX, Periodicities, Sample, StateKind,
    models::{CannotTrain, HistogramCycle, HypertimeOptions, Readings},
    time::{format_duration, parse_duration},
};

/// A model with all its parameters, ready to be trained.
#[derive(Clone, Debug)]
pub struct ParameterSet {
    shown: String,
    kind: ModelKind,
    options: TrainingOptions,
    periodicities: Periodicities,
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

const DURATION: &str = "a duration such as 10m, 1d or 7d";
const PERIOD_BASE_NANOS: i64 = 7 * 86_400 * crate::time::NANOS_PER_SEC;
const PERIOD_COUNT: usize = 168;

/// The value of a parameter; `right` describes the possible values.
fn read<T>(
    name: &'static str,
    text: &str,
    right: &str,
    value: impl FnOnce(&str) -> Option<T>,
) -> Result<T, WrongParameter> {
    value(text).ok_or_else(|| WrongParameter::Value { name, right: right.to_owned() })
}

/// A count. The model itself refuses a count that is too high.
fn count(name: &'static str, text: &str, right: &str) -> Result<u32, WrongParameter> {
    let number: usize = read(name, text, right, |text| text.parse().ok())?;
    Ok(u32::try_from(number).unwrap_or(u32::MAX))
}

fn number(name: &'static str, text: &str, right: &str) -> Result<f64, WrongParameter> {
    read(name, text, right, |text| text.parse().ok().filter(|number: &f64| number.is_finite()))
}

fn duration(name: &'static str, text: &str) -> Result<i64, WrongParameter> {
    read(name, text, DURATION, |text| parse_duration(text).ok())
}

fn order(name: &'static str, text: &str) -> Result<usize, WrongParameter> {
    let order = |text: &str| text.parse().ok().filter(|&order: &usize| order <= ORDER_MAX);
    read(name, text, "a whole number from 0 to 15", order)
}

fn cycle(name: &'static str, text: &str) -> Result<HistogramCycle, WrongParameter> {
    read(name, text, "day, week or weekend", HistogramCycle::named)
}

fn harmonics(base_nanos: i64, count: usize) -> Result<Periodicities, WrongParameter> {
    Periodicities::harmonics(base_nanos, u32::try_from(count).unwrap_or(u32::MAX)).map_err(|refused| {
        WrongParameter::Together(format!(
            "period_base {} with period_count {count}: {refused}",
            format_duration(base_nanos)
        ))
    })
}

impl ParameterSet {
    /// A model of the kind with some of the parameters that [`super::ModelInfo::parameters`] lists, and defaults for
    /// the others; a parameter that is not listed is ignored.
    ///
    /// # Errors
    /// [`WrongParameter`] if a value cannot be read or the model refuses it.
    pub fn new(kind: ModelKind, parameters: &[(&'static str, &str)]) -> Result<ParameterSet, WrongParameter> {
        // Without the parameter, hypertime of an experiment has up to ten clusters; a request and the nightly update
        // have three.
        let mut kind = if kind.hypertime_options().is_some() {
            kind.with_count(HypertimeOptions::default().clusters as u32)
        } else {
            kind
        };
        let mut options = TrainingOptions::default();
        let (mut period_base, mut period_count) = (PERIOD_BASE_NANOS, PERIOD_COUNT);
        for &name in kind.info().parameters {
            let Some(&(_, text)) = parameters.iter().find(|(given, _)| *given == name) else { continue };
            match name {
                "cycle" => {
                    // The number of bins stays as it is.
                    let bins = kind.count();
                    kind = kind.with_cycle(cycle(name, text)?);
                    kind = bins.map_or(kind, |bins| kind.with_count(bins));
                }
                "bins" => kind = kind.with_count(count(name, text, "a whole number from 1")?),
                "gaussians" => kind = kind.with_count(count(name, text, "a whole number from 1 to 20")?),
                "clusters" => kind = kind.with_count(count(name, text, "a whole number from 1 to 50")?),
                "period" => kind = kind.with_period(duration(name, text)?),
                "seed" => options.seed = read(name, text, "a whole number from 0", |text| text.parse().ok())?,
                "order" => options.order = order(name, text)?,
                "smoothing_bins" => options.smoothing_bins = number(name, text, "a number of bins, 0 for none")?,
                "prior_readings" => options.prior_readings = number(name, text, "a number from 0")?,
                "bin" => options.bin_nanos = duration(name, text)?,
                "period_base" => period_base = duration(name, text)?,
                "period_count" => {
                    let right = "a whole number from 1 to 2048";
                    period_count = read(name, text, right, |text| text.parse().ok())?;
                }
                _ => {}
            }
        }
        let periodicities = harmonics(period_base, period_count)?;
        let shown: Vec<String> = parameters.iter().map(|(name, text)| format!("{name}={text}")).collect();
        let set = ParameterSet { shown: shown.join(" "), kind, options, periodicities };
        set.checked()
    }

    /// Training on one reading makes the model check its parameters.
    fn checked(self) -> Result<ParameterSet, WrongParameter> {
        if self.kind == ModelKind::Uniform {
            // The uniform model needs two readings.
            return Ok(self);
        }
        let reading = [Sample { utc_nanos: 0, offset_secs: 0, value: 0.5 }];
        match self.train(&reading, StateKind::Probability) {
            Err(refused @ (CannotTrain::Parameter { .. } | CannotTrain::Irregular { .. })) => {
                Err(WrongParameter::Together(refused.to_string()))
            }
            Ok(_) | Err(CannotTrain::NoReadings | CannotTrain::Stop(_)) => Ok(self),
        }
    }

    /// The given parameters, such as `bins=24 cycle=day`.
    pub fn shown(&self) -> &str {
        &self.shown
    }

    /// Trains the model on the readings of one state, ascending by time.
    ///
    /// # Errors
    /// [`CannotTrain`] without readings, or if a value is out of the model's range.
    pub fn train(&self, samples: &[Sample], kind: StateKind) -> Result<TrainedModel, CannotTrain> {
        self.kind.train_with(Readings::new(samples), kind, &self.periodicities, self.options)
    }
}
