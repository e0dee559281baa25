//! Warped hypertime: time is mapped onto circles, one for each period found, and clustered there.
//!
//! Krajník et al., "Warped Hypertime Representations for Long-term Autonomy of Mobile Robots", RA-L 2019 ("RA-L 2019"),
//! section III. Each reading gets a cosine and a sine for each period, mixtures are trained on these points, and the
//! strongest period left in the error is the next one. HyT-EM places Gaussians over the circles' plane coordinates,
//! HyT-KM starts from k-means, keeps to the cosine distance on circles, and finds the number of clusters itself.
//! [`Hypertime::train`] lists the departures from the paper. Invariant: at most five periods and 50 clusters; every
//! prediction is finite, that of a probability in `[0,1]`.

use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::{InvalidParts, Periodicities, Sample};

mod axis;
mod candidates;
mod cluster;
mod concentration;
mod conditional;
mod field;
mod fields;
mod grow;
mod joint;
mod mixture;
mod odds;
mod options;
mod raster;
mod residuals;
mod seeding;
mod training;

pub use axis::HypertimeAxis;
use candidates::Candidates;
pub use candidates::HypertimePeriod;
pub use cluster::HypertimeCluster;
pub use conditional::HypertimeDistribution;
pub use field::{FieldReading, HypertimeField, HypertimeFieldParts};
use grow::{Dealing, Growth, deal, grow, unit_weight};
pub use odds::HypertimeOddsParts;
use odds::Odds;
pub use options::{HypertimeMethod, HypertimeOptions};
use training::{OddsReading, OddsTraining};

#[cfg(test)]
mod tests;

/// The parts of a [`Hypertime`], for storage.
#[derive(Clone, Debug, PartialEq)]
pub enum HypertimeParts {
    /// The parts of a model of a probability.
    Probability(HypertimeOddsParts),
    /// The parts of a model of any other number.
    Continuous(HypertimeFieldParts),
}

/// The value of one state over time, by warped hypertime.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypertime {
    shape: HypertimeKind,
}

#[derive(Clone, Debug, PartialEq)]
enum HypertimeKind {
    Probability(Odds),
    Continuous(HypertimeField),
}

impl Hypertime {
    /// Trains the model of a probability; values outside `[0,1]` count as the nearer end. The periods are chosen among
    /// those of a map, a month and a year. Readings are summed by slots (of the week, of five minutes; for cycles of a
    /// year, of an hour), so that years of readings take little longer than weeks.
    ///
    /// Departures from RA-L 2019: the error in which periods are searched, and which stops the growth (eq. 6), is that
    /// of held-out readings, a quarter of the days at a time (of the hours, if there are fewer than four days), and a
    /// period must lower it by a hundredth; of several seeded starts, the one with the highest likelihood of those
    /// readings is kept; there are at most five periods, the longest cycle of the map divided by at most 84 (by 365 for
    /// a year); covariances have a prior.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings or an option is outside its range.
    pub fn train(
        readings: Readings<'_>,
        periodicities: &Periodicities,
        options: &HypertimeOptions,
    ) -> Result<Hypertime, CannotTrain> {
        options.check()?;
        let samples = readings.samples;
        if samples.is_empty() {
            return Err(CannotTrain::NoReadings);
        }
        let civil: Vec<i64> = samples.iter().map(|sample| sample.civil_nanos()).collect();
        let (folds_of, folds) = deal(&civil, Dealing::InTurn);
        let unit = unit_weight(&civil, readings.weights().sum());
        let reading = |(((sample, weight), civil_nanos), fold): (((&Sample, f64), i64), usize)| {
            let probability = if sample.value.is_nan() { 0.0 } else { sample.value.clamp(0.0, 1.0) };
            OddsReading { civil_nanos, fold, weight, probability }
        };
        let weighted = samples.iter().zip(readings.weights()).zip(civil).zip(folds_of);
        let weighted: Vec<OddsReading> = weighted.map(reading).collect();
        let candidates = Candidates::new(periodicities, samples.iter().map(|sample| sample.utc_nanos));
        let training = OddsTraining::new(&weighted, folds, candidates, (options.method, unit, readings.stop));
        let odds = grow(&training, &Growth { folds, stop: readings.stop }, options);
        readings.stop.check()?;
        Ok(Hypertime { shape: HypertimeKind::Probability(odds) })
    }

    /// Trains the model of a value that is not a probability, such as a speed or a count, with
    /// [`HypertimeField::train`].
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, an option is outside its range, or a value is not finite.
    pub fn train_continuous(
        readings: Readings<'_>,
        periodicities: &Periodicities,
        options: &HypertimeOptions,
    ) -> Result<Hypertime, CannotTrain> {
        let of_one_place = readings.samples.iter().map(|sample| FieldReading {
            moment: sample.moment(),
            location: Vec::new(),
            value: vec![sample.value],
        });
        let (points, weights): (Vec<FieldReading>, Vec<f64>) = of_one_place.zip(readings.weights()).unzip();
        let field = HypertimeField::train_weighted(&points, &weights, (periodicities, options), readings.stop)?;
        Ok(Hypertime { shape: HypertimeKind::Continuous(field) })
    }

    /// The distribution p(a | t) at a moment of a value that is not a probability; `None` for a probability, which the
    /// prediction describes fully.
    pub fn distribution(&self, at: Moment) -> Option<HypertimeDistribution> {
        match &self.shape {
            HypertimeKind::Probability(_) => None,
            HypertimeKind::Continuous(field) => field.distribution(at, &[]),
        }
    }

    /// The periods found, in seconds, in the order found; at most five.
    pub fn periods_secs(&self) -> Vec<f64> {
        let periods = match &self.shape {
            HypertimeKind::Probability(odds) => odds.periods(),
            HypertimeKind::Continuous(field) => field.periods(),
        };
        periods.iter().map(|period| period.secs()).collect()
    }

    /// The method of clustering.
    pub fn method(&self) -> HypertimeMethod {
        match &self.shape {
            HypertimeKind::Probability(odds) => odds.method(),
            HypertimeKind::Continuous(field) => field.method(),
        }
    }

    /// The parts of the model; a model built from them has equal predictions.
    pub fn to_parts(&self) -> HypertimeParts {
        match &self.shape {
            HypertimeKind::Probability(odds) => HypertimeParts::Probability(odds.to_parts()),
            HypertimeKind::Continuous(field) => HypertimeParts::Continuous(field.to_parts()),
        }
    }

    /// The model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] if numbers are outside their range, lists have the wrong length, or a continuous model has a
    /// location or more than one number as its value.
    pub fn from_parts(parts: &HypertimeParts) -> Result<Hypertime, InvalidParts> {
        let shape = match parts {
            HypertimeParts::Probability(odds) => HypertimeKind::Probability(Odds::from_parts(odds)?),
            HypertimeParts::Continuous(field) => {
                InvalidParts::check("location", field.location.len() as f64, 0.0..=0.0)?;
                InvalidParts::check("value", field.value.len() as f64, 1.0..=1.0)?;
                HypertimeKind::Continuous(HypertimeField::from_parts(field)?)
            }
        };
        Ok(Hypertime { shape })
    }
}

impl TemporalModel for Hypertime {
    /// The probability, or the mean of the conditional distribution (RA-L 2019 eq. 4), at a moment.
    fn predict(&self, at: Moment) -> f64 {
        match &self.shape {
            HypertimeKind::Probability(odds) => odds.at(at.civil_nanos()),
            // A model without location and with one number always predicts.
            HypertimeKind::Continuous(field) => {
                field.mean(at, &[]).and_then(|mean| mean.first().copied()).unwrap_or(0.0)
            }
        }
    }
}
