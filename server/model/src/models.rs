//! The temporal models of one state, behind one small interface.
//!
//! Each model is trained on the readings of one state and predicts its value at a moment; a new kind of model is a file
//! here, with a function that trains it, a [`TemporalModel`] implementation and parts for storage. The nightly update
//! chooses between the spectral model, histograms and models trained on readings by held-out error
//! (`state/alternatives.rs`); the other models are trained when a query asks for them, always on learned data in order
//! of time, so that the same data gives the same model. Invariant: for all readings, a prediction is finite.

mod alarm;
mod calibrated;
mod fixed_order;
mod flow;
mod histogram;
mod hypertime;
mod interval;
mod latest;
pub(crate) mod markov_chain;
mod mean;
mod pergam;
mod poisson;
mod presence;
mod support;
mod uniform;

#[cfg(test)]
mod training_stop_tests;

pub use alarm::{ChangeAlarm, ChangeAlarmParts, DayErrors};
pub use calibrated::{Calibrated, CalibratedOptions, CalibratedParts};
pub use fixed_order::FixedOrder;
pub use flow::{
    CellFlow, FLOW_BINS_MAX, FLOW_DIRECTIONS, FLOW_INTERVAL_NANOS, FlowDetection, FlowModel, FlowOptions, FlowRaster,
};
pub(crate) use histogram::hour_runs;
pub use histogram::{
    HISTOGRAM_PRIOR_READINGS, Histogram, HistogramCycle, HistogramParts, HistogramSettings, HourSpread, HourTable,
    HourTableParts,
};
pub use hypertime::{
    FieldReading, Hypertime, HypertimeAxis, HypertimeCluster, HypertimeDistribution, HypertimeField,
    HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts, HypertimeOptions, HypertimeParts, HypertimePeriod,
};
pub use interval::{HourMoments, Interval, credible_interval, value_interval, value_interval_of, value_tail};
pub use latest::{Latest, LatestParts};
pub use markov_chain::{MarkovChain, MarkovChainParts};
pub use mean::{Mean, MeanParts};
pub use pergam::{Pergam, PergamGaussian, PergamOptions, PergamParts};
pub use poisson::{COUNT_BIN_NANOS, CountRate, CountRateParts, PoissonSpectral, PoissonSpectralParts};
pub use presence::{Presence, PresenceOptions};
pub use support::{DependenceSums, OrderGains, OrderGainsParts, effective_observations, supported_order};
pub(crate) use support::{half_square_of_probabilities, half_square_of_values, supported_order_of};
pub use uniform::{UniformSpectral, UniformSpectralParts};

use crate::{EarlyStop, Sample, StopSignal, civil::NANOS_PER_SEC};

/// The greatest age of readings, against the state's newest, that a model is trained on at night: twelve weeks, in
/// nanoseconds. Older days would hardly count in a calibrated model, and training takes no longer after a year than
/// after these weeks.
pub const NIGHTLY_WINDOW_NANOS: i64 = 84 * 86_400 * NANOS_PER_SEC;

/// A moment with its local time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// UTC, nanoseconds since 1970.
    pub utc_nanos: i64,
    /// The UTC offset of the map's zone, in seconds, east positive.
    pub offset_secs: i32,
}

impl Moment {
    /// Local civil time, nanoseconds since 1970-01-01T00:00 local; saturates at the ends of `i64`.
    pub fn civil_nanos(self) -> i64 {
        self.utc_nanos.saturating_add(i64::from(self.offset_secs) * NANOS_PER_SEC)
    }
}

impl Sample {
    /// The moment of the observation.
    pub fn moment(&self) -> Moment {
        Moment { utc_nanos: self.utc_nanos, offset_secs: self.offset_secs }
    }
}

/// The interface of all temporal models.
pub trait TemporalModel {
    /// The predicted value at a moment; for a probability or a binary state it is in `[0,1]`.
    fn predict(&self, at: Moment) -> f64;
}

/// The training data of a model: the readings of one state.
#[derive(Clone, Copy, Debug)]
pub struct Readings<'a> {
    /// Ascending by UTC time, values finite; equal times may occur.
    pub samples: &'a [Sample],
    /// The age, in seconds against the newest reading, at which a reading counts half; `None`: all have equal weight.
    pub half_life_secs: Option<f64>,
    /// Ends the training early, with [`CannotTrain::Stop`].
    pub stop: StopSignal<'a>,
}

impl<'a> Readings<'a> {
    /// Readings of equal weight.
    pub fn new(samples: &'a [Sample]) -> Readings<'a> {
        Readings { samples, half_life_secs: None, stop: StopSignal::NEVER }
    }

    /// The weight of each reading, in `(0,1]`, in the order of the samples: 0.5^(age / half-life), the newest 1.
    pub fn weights(self) -> impl Iterator<Item = f64> + use<'a> {
        let newest_nanos = self.samples.last().map_or(0, |sample| sample.utc_nanos);
        let half_life_secs = self.half_life_secs;
        self.samples.iter().map(move |sample| match half_life_secs {
            Some(half_life_secs) if half_life_secs > 0.0 => {
                let age_secs = newest_nanos.abs_diff(sample.utc_nanos) as f64 / 1e9;
                // The weight is above 0 for any age, so that a single reading still counts.
                libm::exp2(-age_secs / half_life_secs).max(f64::MIN_POSITIVE)
            }
            _ => 1.0,
        })
    }
}

/// The reason why a model could not be trained.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum CannotTrain {
    /// There are no readings.
    #[error("there are no observations to train the model on")]
    NoReadings,
    /// A parameter is outside its range.
    #[error("{parameter} is {found}, expected {expected}")]
    Parameter { parameter: &'static str, found: f64, expected: &'static str },
    /// The readings are not regular, and the model needs them to be.
    #[error(
        "the model needs regular observations without gaps, each within 1 % of its time: these are {interval_secs} s \
         apart, but the one at {at_secs} (Unix seconds) comes {after_secs} s after the one before; the spectral model \
         needs no regular ones"
    )]
    Irregular { interval_secs: f64, at_secs: f64, after_secs: f64 },
    /// The training was stopped.
    #[error(transparent)]
    Stop(#[from] EarlyStop),
}
