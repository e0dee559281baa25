//! Temporal models of one state: at which times it has which value.
//!
//! The models are FreMEn, Frequency Map Enhancement: Krajník et al., "FreMEn: Frequency Map Enhancement for Long-Term
//! Mobile Robot Autonomy in Changing Environments", T-RO 2017 ("T-RO"), and Santos et al., "Lifelong Information-Driven
//! Exploration to Complete and Refine 4-D Spatio-Temporal Maps", RA-L 2016 ("RA-L"). A state is anything with a value
//! Exploration to Complete and Refine 4-D Spatio-Temporal Maps", RA-L 2016 ("RA-L"). A state is anything with a value
//! over time: a probability or, by its [`StateKind`], another number. Examples are a door, a cell, an edge, and the
//! speed of people at a place. This crate has no data about the place of a state, other states, files or the network.
//!
//! Invariants: no I/O, no clock, no randomness; a sum over observations does not depend on their
//! order or on how they were batched (to 1e-9); every prediction lies in the bounds of its state's kind, `[0,1]` of a
//! probability.
//!
//! ```
//! use tidemap_model::{OrderCriterion, Periodicities, Sample, StateModel};
//!
//! // A door that is open in the second half of every hour, seen once a minute for two weeks.
//! let periodicities = Periodicities::default();
//! let samples: Vec<Sample> = (0..20_160)
//!     .map(|minute: i64| Sample {
//!         utc_nanos: minute * 60_000_000_000,
//!         offset_secs: 0,
//!         value: if minute % 60 >= 30 { 1.0 } else { 0.0 },
//!     })
//!     .collect();
//! let mut door = StateModel::new(&periodicities);
//! let outcome = door.update(&periodicities, OrderCriterion::SquaredError, samples);
//! assert_eq!(outcome.order, 1);
//! let open = door.spectral().predict(&periodicities, door.order(), 45 * 60_000_000_000);
//! assert!(open > 0.95);
//! ```
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod accumulator;
mod angle;
mod belief;
pub mod catalogue;
mod civil;
mod ensemble;
mod entropy;
mod evaluate;
pub mod fields;
mod gaps;
mod hours_seen;
mod information;
mod instruction_set;
mod kind;
pub mod label_evidence;
mod lanes;
pub mod models;
mod order;
mod periodicity;
mod persistence;
mod phasor;
mod phasor_sum;
mod position;
mod predictive;
mod reporting;
mod sample;
pub mod selector;
pub mod special;
mod spectral;
mod state;
mod stop_signal;
mod surprise;
pub mod time;
mod update_worth;
pub mod words;

pub use accumulator::{Accumulator, AccumulatorParts, ShortRecord, SpectrumCell, SpectrumSource};
pub use angle::{
    ANGLE_AXES, ANGLE_EXPECTED, ANGLE_MAX_RAD, allows_angle, circular_deviation_rad, cos_sin,
    deviation_of_direction_rad, direction_rad,
};
pub use belief::{
    Belief, InvalidStateSensor, KnownAtNewest, Rates, Recent, RecentSpan, SPANS_MAX, SensorNoise, StateSensor,
};
pub use catalogue::{EnabledModels, TrainedModel, TrainedModelParts};
pub use civil::{LocalDay, LocalInstant, OffsetCache, UnknownZone, Zone};
pub use ensemble::{AnyEnsemble, Ensemble, NumberEnsemble, OtherModels, TrainedEnsemble};
pub use entropy::{INFORMATION_CERTAINTY, entropy_bits};
pub use evaluate::{Evaluation, evaluate};
pub use gaps::{GapSample, Gaps, GapsParts};
pub use hours_seen::{Evidence, HoursSeen, kind_and_hour};
pub use information::{InformationMeasure, learning_bits};
pub use instruction_set::{InstructionSet, NoSuchInstructions};
pub use kind::{StateKind, VALUE_MAX};
pub use label_evidence::LABELS;
pub use order::{OrderCriterion, OrderErrors, OrderErrorsParts};
pub use periodicity::{InvalidPeriodicities, Periodicities, PeriodicityDefinition};
pub use persistence::{MemoryBasis, Persistence, PersistenceParts};
pub use phasor::PhasorTable;
pub use phasor_sum::{PhasorSum, RunningSums};
pub use position::{Dimensions, Position};
pub use predictive::{HeldInterval, Predictive};
pub use reporting::{
    Hold, InvalidHold, InvalidReporting, LearnedRows, Reporting, Row, RowKind, RowReadings, StatedReporting,
};
pub use sample::Sample;
pub use spectral::{CellSums, Component, InstantPhasors, ReadingSums, ScoreSums, SpectralModel};
pub use state::{
    ActiveModel, Alternatives, AlternativesParts, ChosenMember, Combination, DayScores, LearnedReadings, OrderWatch,
    OrderWatchParts, StateModel, TrainingRecordParts, UpdateOutcome, UpdateRules, choose_together,
};
pub use stop_signal::{EarlyStop, StopSignal};
pub use surprise::{
    JudgedReading, KEPT_CONFIDENCE, RUNS_MAX as SURPRISE_RUNS_MAX, SurpriseRun, Surprises, observed_bits,
};
pub use update_worth::UpdateWorth;

/// The version number of the mathematics. It rises with every change of the bits that updates learn from one log. Two
/// daemons can compare their digests if their numbers are equal.
pub const MATHS: u32 = 1;

/// The highest model order: at most this many spectral components are kept and used.
pub const ORDER_MAX: usize = 15;

/// The reason why stored parts were refused: they cannot have come from this crate's `to_parts`.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InvalidParts {
    /// The spectrum must have one entry per candidate periodicity, or none without observations.
    #[error("the spectrum has {found} entries, expected {expected}")]
    SpectrumLength { expected: usize, found: usize },
    /// A number is not finite, or outside the range that its meaning allows.
    #[error("{field} is {found}, outside its range")]
    OutOfRange { field: &'static str, found: f64 },
    /// The first observation is later than the last.
    #[error("the first observation, {first_nanos} ns, is later than the last, {last_nanos} ns")]
    TimesReversed { first_nanos: i64, last_nanos: i64 },
    /// Bytes do not have the form of their field.
    #[error("the bytes of {field} do not have their form")]
    Bytes { field: &'static str },
    /// The number of components or the order is above [`ORDER_MAX`].
    #[error("order {found} is above {ORDER_MAX}")]
    OrderTooHigh { found: usize },
}

impl InvalidParts {
    /// `Ok` where `found` lies in `range`; NaN never does.
    #[inline]
    fn check(field: &'static str, found: f64, range: std::ops::RangeInclusive<f64>) -> Result<(), InvalidParts> {
        if range.contains(&found) { Ok(()) } else { Err(InvalidParts::OutOfRange { field, found }) }
    }
}
