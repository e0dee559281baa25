//! The distribution over positions of a vector at a time, by warped hypertime, and the number of positions.
//!
//! Invariant: a model is trained on at least one position, and its results are finite.

use tidemap_map::{event::Dimensions, spec::MapSpec};
use tidemap_model::{
    Sample, StopSignal,
    models::{
        COUNT_BIN_NANOS, CannotTrain, FieldReading, HypertimeDistribution, HypertimeField, HypertimeOptions, Moment,
        PoissonSpectral, Readings, TemporalModel as _,
    },
};

/// Positions are counted in this many intervals at most; longer records have longer intervals.
const COUNTED_MAX: i64 = 100_000;

/// A model that was trained on the positions of a vector.
#[derive(Clone, Debug)]
pub struct PositionModel {
    field: HypertimeField,
    /// The number of positions in an interval (RA-L 2019 section IV.D; the rate after Jovan et al.).
    rate: PoissonSpectral,
    low_m: Vec<f64>,
    high_m: Vec<f64>,
    positions: u64,
}

impl PositionModel {
    /// Trains a model on the readings of all axes of a vector, each ascending by time.
    ///
    /// # Errors
    /// [`CannotTrain`] if an option is out of range, there is no reading, or the axes do not have readings at the same
    /// times.
    pub fn train(
        options: &HypertimeOptions,
        axes: &[impl AsRef<[Sample]>],
        spec: &MapSpec,
        stop: StopSignal<'_>,
    ) -> Result<Self, CannotTrain> {
        let Some(first) = axes.first().map(AsRef::as_ref) else { return Err(CannotTrain::NoReadings) };
        let times = || first.iter().map(|sample| sample.utc_nanos);
        let is_whole = Dimensions::of(axes.len()).is_some();
        let is_one = |axis: &[Sample]| axis.iter().map(|sample| sample.utc_nanos).eq(times());
        if !is_whole || !axes.iter().all(|axis| is_one(axis.as_ref())) {
            let (parameter, found) = ("axes", axes.len() as f64);
            return Err(CannotTrain::Parameter {
                parameter,
                found,
                expected: "2 or 3 with readings of the same times",
            });
        }
        let readings: Vec<FieldReading> = (0..first.len())
            .map(|i| FieldReading {
                moment: Moment { utc_nanos: first[i].utc_nanos, offset_secs: first[i].offset_secs },
                location: Vec::new(),
                value: axes.iter().map(|axis| axis.as_ref()[i].value).collect(),
            })
            .collect();
        let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
        let weights: Vec<f64> = Readings { half_life_secs, ..Readings::new(first) }.weights().collect();
        let field = HypertimeField::train_weighted(&readings, &weights, (&spec.periodicities, options), stop)?;
        let counts = counts(first);
        let rate = Readings { half_life_secs, stop, ..Readings::new(&counts.samples) };
        let rate = PoissonSpectral::train(rate, &spec.periodicities, counts.bin_nanos)?;
        let bound = |axis: &[Sample], start: f64, nearer: fn(f64, f64) -> f64| {
            axis.iter().map(|sample| sample.value).fold(start, nearer)
        };
        let low_m = axes.iter().map(|axis| bound(axis.as_ref(), f64::INFINITY, f64::min)).collect();
        let high_m = axes.iter().map(|axis| bound(axis.as_ref(), f64::NEG_INFINITY, f64::max)).collect();
        Ok(Self { field, rate, low_m, high_m, positions: first.len() as u64 })
    }

    /// Number of positions on which the model was trained.
    pub fn positions(&self) -> u64 {
        self.positions
    }

    /// The least and the greatest coordinates of the training positions, in metres by axis.
    pub fn bounds_m(&self) -> (&[f64], &[f64]) {
        (&self.low_m, &self.high_m)
    }

    /// Expected number of positions per second at a moment.
    pub fn per_sec(&self, at: Moment) -> f64 {
        self.rate.predict(at) / (self.rate.bin_nanos() as f64 / 1e9)
    }

    /// The distribution at a moment; `None` if the distribution is undefined.
    pub fn at(&self, at: Moment) -> Option<HypertimeDistribution> {
        self.field.distribution(at, &[])
    }
}

/// One reading for each position, and a 0 for each interval without one.
struct Counts {
    samples: Vec<Sample>,
    bin_nanos: i64,
}

/// Counts positions, which are taken to be all positions from the first to the last.
fn counts(positions: &[Sample]) -> Counts {
    let (first, last) = (positions.first(), positions.last());
    let span = first.zip(last).map_or(0, |(first, last)| last.utc_nanos.saturating_sub(first.utc_nanos));
    let bin_nanos = COUNT_BIN_NANOS * (span / COUNT_BIN_NANOS / COUNTED_MAX + 1);
    let mut samples: Vec<Sample> = Vec::with_capacity(positions.len());
    for position in positions {
        if let Some(before) = samples.last().copied() {
            let mut next = before.utc_nanos.saturating_add(bin_nanos);
            while next.saturating_add(bin_nanos) <= position.utc_nanos {
                samples.push(Sample { utc_nanos: next, value: 0.0, ..before });
                next = next.saturating_add(bin_nanos);
            }
        }
        samples.push(Sample { value: 1.0, ..*position });
    }
    Counts { samples, bin_nanos }
}
