//! The forecast count of a single reading, from the rate of counts.
//!
//! Invariant: the forecast is positive and finite.

use std::{collections::HashSet, slice};

use super::{COUNT_BIN_NANOS, PoissonSpectral, PoissonSpectralParts};
use crate::models::{CannotTrain, Moment, Readings, TemporalModel};
use crate::{
    Component, InvalidParts, Periodicities,
    fields::{FINITE, StoredFields, Visitor},
};

/// A [`PoissonSpectral`] model in bins of [`COUNT_BIN_NANOS`], and the usual number of readings in an observed bin.
#[derive(Clone, Debug, PartialEq)]
pub struct CountRate {
    bins: PoissonSpectral,
    readings_per_bin: f64,
}

/// The parts of a [`CountRate`], for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CountRateParts {
    /// The periodicities that the model was trained with: those of the map.
    pub periodicities: Periodicities,
    /// The model of the bins.
    pub bins: PoissonSpectralParts,
    /// Mean number of readings in an observed bin, at least 1.
    pub readings_per_bin: f64,
}

/// Tag 1 belongs to the training. The periodicities are those of the map, and not stored.
impl StoredFields for CountRateParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let PoissonSpectralParts { bin_nanos, mean, floor, components } = &mut self.bins;
        visitor.integer(2, "bin of counts", bin_nanos)?;
        let rates = [mean, floor, &mut self.readings_per_bin];
        visitor.lists(3, "rates of counts", FINITE, &mut rates.map(slice::from_mut))?;
        let mut indices: Vec<u32> = components.iter().map(|component| component.periodicity).collect();
        visitor.integers(4, "components of counts", &mut indices)?;
        let mut gammas: Vec<[f64; 2]> = components.iter().map(|one| [one.gamma_re, one.gamma_im]).collect();
        visitor.list(5, "coefficients of counts", FINITE, &mut gammas)?;
        visitor.accept(|| {
            let found = gammas.len() as f64;
            if gammas.len() == indices.len() {
                Ok(())
            } else {
                Err(InvalidParts::OutOfRange { field: "coefficients of counts", found })
            }
        })?;
        let component =
            |(periodicity, [gamma_re, gamma_im]): (u32, [f64; 2])| Component { periodicity, gamma_re, gamma_im };
        *components = indices.into_iter().zip(gammas).map(component).collect();
        Ok(())
    }
}

impl CountRate {
    /// Trains on the counts of single readings.
    ///
    /// # Errors
    /// [`CannotTrain`] in the cases of [`PoissonSpectral::train`].
    pub fn train(readings: Readings<'_>, periodicities: &Periodicities) -> Result<CountRate, CannotTrain> {
        CountRate::train_in_bins(readings, periodicities, COUNT_BIN_NANOS)
    }

    /// Does the same as [`CountRate::train`], with bins of the given length in nanoseconds.
    ///
    /// # Errors
    /// The errors of [`CountRate::train`].
    pub fn train_in_bins(
        readings: Readings<'_>,
        periodicities: &Periodicities,
        bin_nanos: i64,
    ) -> Result<CountRate, CannotTrain> {
        let bins = PoissonSpectral::train(readings, periodicities, bin_nanos)?;
        let observed: HashSet<i64> =
            readings.samples.iter().map(|sample| sample.civil_nanos().div_euclid(bin_nanos)).collect();
        Ok(CountRate { bins, readings_per_bin: readings.samples.len() as f64 / observed.len().max(1) as f64 })
    }

    /// The parts to store.
    pub fn to_parts(&self) -> CountRateParts {
        CountRateParts {
            periodicities: self.bins.periodicities.clone(),
            bins: self.bins.to_parts(),
            readings_per_bin: self.readings_per_bin,
        }
    }

    /// The model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts(parts: CountRateParts) -> Result<CountRate, InvalidParts> {
        InvalidParts::check("readings of a bin", parts.readings_per_bin, 1.0..=f64::MAX)?;
        let bins = PoissonSpectral::from_parts(&parts.periodicities, parts.bins)?;
        Ok(CountRate { bins, readings_per_bin: parts.readings_per_bin })
    }
}

impl TemporalModel for CountRate {
    /// The expected count of a reading; above 0.
    fn predict(&self, at: Moment) -> f64 {
        self.bins.predict(at) / self.readings_per_bin
    }
}
