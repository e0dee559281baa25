//! Values over place and time in hypertime: one mixture over location, circles and value (RA-L 2019 eq. 2).
//!
//! The value at a place and time is then a mixture of Gaussians, conditional on both (section III.F; in closed form
//! here, not on a raster of values). Invariant: every result is finite, and a mean lies within the observed range.

use super::axis::{HypertimeAxis, standardised};
use super::candidates::{Candidates, HypertimePeriod, project};
use super::cluster::COORDINATES_MAX;
use super::conditional::HypertimeDistribution;
use super::grow::{Dealing, Growth, deal, grow, unit_weight};
use super::joint::{FieldPoint, FieldTraining};
use super::mixture::Mixture;
use super::{HypertimeCluster, HypertimeMethod, HypertimeOptions};
use crate::models::{CannotTrain, Moment};
use crate::{InvalidParts, Periodicities, StopSignal};

#[cfg(test)]
mod tests;

/// Maximum number of coordinates of location and value together.
const DIMENSIONS_MAX: usize = COORDINATES_MAX - 10;

/// One reading of a value with a location.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldReading {
    /// The moment.
    pub moment: Moment,
    /// The location: any number of coordinates, equal for all readings; empty for a value of one place.
    pub location: Vec<f64>,
    /// The value: one or more numbers, equally many for all readings. For events it is the place of the event.
    pub value: Vec<f64>,
}

/// The parts of a [`HypertimeField`], for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct HypertimeFieldParts {
    /// The method of clustering.
    pub method: HypertimeMethod,
    /// The periods, in the order found; at most five.
    pub periods: Vec<HypertimePeriod>,
    /// The scale of each coordinate of a location.
    pub location: Vec<HypertimeAxis>,
    /// The scale of each coordinate of a value.
    pub value: Vec<HypertimeAxis>,
    /// The clusters, at least one.
    pub clusters: Vec<HypertimeCluster>,
}

/// The distribution of a value over place and time.
#[derive(Clone, Debug, PartialEq)]
pub struct HypertimeField {
    method: HypertimeMethod,
    periods: Vec<HypertimePeriod>,
    location: Vec<HypertimeAxis>,
    value: Vec<HypertimeAxis>,
    mixture: Mixture,
}

impl HypertimeField {
    /// Trains the model with the method of [`super::Hypertime::train`] and the candidate periods of a map. If there are
    /// more than 4,000 readings, one is drawn from each of 4,000 equal runs in the given order.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, an option is outside its range, readings differ in their number of
    /// coordinates, have no value or more than 16 coordinates in total, or a coordinate is not finite.
    pub fn train(
        readings: &[FieldReading],
        periodicities: &Periodicities,
        options: &HypertimeOptions,
    ) -> Result<HypertimeField, CannotTrain> {
        let weights = vec![1.0; readings.len()];
        HypertimeField::train_weighted(readings, &weights, (periodicities, options), StopSignal::NEVER)
    }

    /// Does the same as [`HypertimeField::train`], but each reading has a weight above 0, and the training can be
    /// stopped.
    ///
    /// # Errors
    /// The errors of [`HypertimeField::train`]; also an error if the number of weights differs from that of readings,
    /// or a weight is not a finite number above 0; [`CannotTrain::Stop`].
    pub fn train_weighted(
        readings: &[FieldReading],
        weights: &[f64],
        (periodicities, options): (&Periodicities, &HypertimeOptions),
        stop: StopSignal<'_>,
    ) -> Result<HypertimeField, CannotTrain> {
        options.check()?;
        let Some(first) = readings.first() else { return Err(CannotTrain::NoReadings) };
        check_weights(weights, readings.len())?;
        let (locations, values) = (first.location.len(), first.value.len());
        check_dimensions(readings, locations, values)?;
        let column = |number: &dyn Fn(&FieldReading) -> f64| HypertimeAxis::of(readings.iter().map(number));
        let location: Vec<HypertimeAxis> = (0..locations).map(|i| column(&|reading| reading.location[i])).collect();
        let value: Vec<HypertimeAxis> = (0..values).map(|i| column(&|reading| reading.value[i])).collect();

        let kept = FieldPoint::thinned(readings.len(), options.seed);
        let civil: Vec<i64> = kept.iter().map(|&index| readings[index].moment.civil_nanos()).collect();
        let (folds_of, folds) = deal(&civil, Dealing::Shuffled);
        let unit = unit_weight(&civil, kept.iter().map(|&index| weights[index]).sum());
        let readable = kept.iter().zip(civil).zip(folds_of).map(|((&index, civil_nanos), fold)| FieldPoint {
            civil_nanos,
            fold,
            weight: weights[index],
            location: standardised(&readings[index].location, &location),
            value: standardised(&readings[index].value, &value),
        });
        let mut times: Vec<i64> = readings.iter().map(|reading| reading.moment.utc_nanos).collect();
        times.sort_unstable();
        let candidates = Candidates::new(periodicities, times.into_iter());
        let (readings, value_axes) = (readable.collect(), value.clone());
        let joint = FieldTraining { readings, candidates, method: options.method, value: value_axes, unit, stop };
        let (periods, mixture) = grow(&joint, &Growth { folds, stop }, options);
        stop.check()?;
        Ok(HypertimeField { method: options.method, periods, location, value, mixture })
    }

    /// The distribution of the value at a place and time; `None` if the location has another number of coordinates than
    /// the training data, or one is not finite.
    pub fn distribution(&self, at: Moment, location: &[f64]) -> Option<HypertimeDistribution> {
        if location.len() != self.location.len() || !location.iter().all(|number| number.is_finite()) {
            return None;
        }
        let mut coordinates = standardised(location, &self.location);
        let mut hypertime = Vec::with_capacity(2 * self.periods.len());
        project(at.civil_nanos(), &self.periods, &mut hypertime);
        let circles = match self.method {
            HypertimeMethod::Em => {
                coordinates.append(&mut hypertime);
                Vec::new()
            }
            HypertimeMethod::Km => hypertime,
        };
        Some(HypertimeDistribution::new(self.mixture.given(&coordinates, &circles), self.value.clone()))
    }

    /// Probability density p(a | x, t) of a value at a place and time, per unit of each of its coordinates. `None` in
    /// the cases of [`HypertimeField::distribution`], for the location or the value.
    pub fn density(&self, at: Moment, location: &[f64], value: &[f64]) -> Option<f64> {
        self.distribution(at, location)?.density(value, &vec![0.0; value.len()])
    }

    /// The expected value at a place and time (RA-L 2019 eq. 4, of the conditional distribution); `None` in the cases
    /// of [`HypertimeField::distribution`].
    pub fn mean(&self, at: Moment, location: &[f64]) -> Option<Vec<f64>> {
        Some(self.distribution(at, location)?.mean())
    }

    pub(super) fn method(&self) -> HypertimeMethod {
        self.method
    }

    /// The periods of the model, in the order found.
    pub fn periods(&self) -> &[HypertimePeriod] {
        &self.periods
    }

    /// The parts of the model; a model built from them has equal predictions.
    pub fn to_parts(&self) -> HypertimeFieldParts {
        HypertimeFieldParts {
            method: self.method,
            periods: self.periods.clone(),
            location: self.location.clone(),
            value: self.value.clone(),
            clusters: self.mixture.to_parts(),
        }
    }

    /// The model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] if numbers are outside their range or lists have the wrong length.
    pub fn from_parts(parts: &HypertimeFieldParts) -> Result<HypertimeField, InvalidParts> {
        HypertimePeriod::check(&parts.periods)?;
        let (locations, values) = (parts.location.len(), parts.value.len());
        InvalidParts::check("value", values as f64, 1.0..=DIMENSIONS_MAX as f64)?;
        InvalidParts::check("location", (locations + values) as f64, 1.0..=DIMENSIONS_MAX as f64)?;
        InvalidParts::check("clusters", parts.clusters.len() as f64, 1.0..=HypertimeOptions::CLUSTERS_MAX as f64)?;
        parts.location.iter().chain(&parts.value).try_for_each(HypertimeAxis::check)?;
        let count = parts.periods.len();
        let (hypertime, circles) = match parts.method {
            HypertimeMethod::Em => (2 * count, 0),
            HypertimeMethod::Km => (0, count),
        };
        Ok(HypertimeField {
            method: parts.method,
            periods: parts.periods.clone(),
            location: parts.location.clone(),
            value: parts.value.clone(),
            mixture: Mixture::from_parts(&parts.clusters, locations + hypertime + values, circles)?,
        })
    }
}

fn check_weights(weights: &[f64], readings: usize) -> Result<(), CannotTrain> {
    let refused = |parameter, found, expected| Err(CannotTrain::Parameter { parameter, found, expected });
    if weights.len() != readings {
        return refused("weights", weights.len() as f64, "as many as readings");
    }
    match weights.iter().find(|weight| !(**weight > 0.0 && weight.is_finite())) {
        Some(&found) => refused("weight", found, "a finite number above 0"),
        None => Ok(()),
    }
}

fn check_dimensions(readings: &[FieldReading], locations: usize, values: usize) -> Result<(), CannotTrain> {
    let refused = |parameter, found, expected| Err(CannotTrain::Parameter { parameter, found, expected });
    if values == 0 || locations.saturating_add(values) > DIMENSIONS_MAX {
        let found = (locations as f64) + values as f64;
        return refused("coordinates", found, "one or more of the value, at most 16 with those of the location");
    }
    for reading in readings {
        if reading.location.len() != locations {
            return refused("location coordinates", reading.location.len() as f64, "as many in every reading");
        }
        if reading.value.len() != values {
            return refused("value coordinates", reading.value.len() as f64, "as many in every reading");
        }
        if let Some(&found) = reading.location.iter().chain(&reading.value).find(|number| !number.is_finite()) {
            return refused("reading", found, "finite numbers");
        }
    }
    Ok(())
}
