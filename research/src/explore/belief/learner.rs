//! Models of one state, trained every midnight on the readings of visits.
//!
//! Invariant: a state without readings has probability 0.5.

use tidemap_model::{
    OrderCriterion, Periodicities, Sample, StateKind, StateModel, TrainedModel, UpdateRules,
    catalogue::{ModelKind, NIGHTLY_WINDOW_NANOS, TRAINED_AT_NIGHT, TrainingCost},
    models::{CannotTrain, Moment, Readings, TemporalModel},
};

use super::Known;

/// Maximum number of components of the spectral model.
const ORDER_MAX: usize = 8;
/// Candidate periodicities: the harmonics of four weeks down to two hours (RAS 2017, section 4.1.1).
const PERIOD_BASE_NANOS: i64 = 28 * 86_400 * 1_000_000_000;
const PERIOD_COUNT: u32 = 28 * 12;
/// The lowest order is chosen whose error is within this factor of the lowest error, as in a map.
const NEAR_TIE: f64 = 1.001;

/// The short-term memory of RAS 2017: a Markov chain from the last reading on, which needs no training at midnight.
pub(super) const SHORT_TERM: ModelKind = ModelKind::Persistence;

/// The kinds of models by which explorers learn the places, with their default parameters. [`ModelKind::Mean`] is the
/// long-term memory of RAS 2017, [`SHORT_TERM`] its short-term memory. [`ModelKind::Spectral`] has the number of
/// components up to eight that predicted best.
pub(super) fn kinds() -> impl Iterator<Item = ModelKind> {
    // Left out: auto, since no update chooses here; latest, from which the chain starts; and uniform, which refuses the
    // irregular times of visits.
    let is_unsuitable = |kind: &ModelKind| matches!(kind, ModelKind::Auto | ModelKind::Latest | ModelKind::Uniform);
    // Every place is trained every midnight.
    let is_slow = |kind: &ModelKind| kind.cost() == Some(TrainingCost::High);
    let supported = ModelKind::ALL.into_iter().filter(|kind| kind.supports(StateKind::Probability));
    supported.filter(move |kind| !is_unsuitable(kind) && !is_slow(kind))
}

/// A model of one state with its training data.
pub(super) struct Learner {
    kind: ModelKind,
    trained: Option<TrainedModel>,
    nightly: Option<Nightly>,
}

/// A state that learns night by night, as in a map.
struct Nightly {
    periodicities: Periodicities,
    state: StateModel,
    learned: usize,
}

impl Learner {
    /// An untrained model.
    pub(super) fn new(kind: ModelKind) -> Learner {
        Learner { kind, trained: None, nightly: None }
    }

    /// The kind of the model.
    pub(super) fn kind(&self) -> ModelKind {
        self.kind
    }

    /// Trains on all readings; earlier ones must come first.
    pub(super) fn learn(&mut self, readings: &[Sample]) -> Result<(), CannotTrain> {
        if readings.is_empty() {
            return Ok(());
        }
        self.trained = match self.kind {
            ModelKind::Spectral => {
                self.nightly(readings, OrderCriterion::SquaredError)?;
                None
            }
            ModelKind::Ensemble => {
                self.nightly(readings, UpdateRules::default())?.train(readings)?;
                None
            }
            SHORT_TERM => None,
            kind => Some(kind.train(Readings::new(readings), StateKind::Probability, &Periodicities::default())?),
        };
        Ok(())
    }

    /// The state after it has learned the new readings.
    fn nightly(&mut self, readings: &[Sample], rules: impl Into<UpdateRules>) -> Result<&mut Nightly, CannotTrain> {
        let nightly = match &mut self.nightly {
            Some(nightly) => nightly,
            none => {
                let periodicities = match self.kind {
                    ModelKind::Spectral => harmonics()?,
                    _ => Periodicities::default(),
                };
                none.insert(Nightly { state: StateModel::new(&periodicities), periodicities, learned: 0 })
            }
        };
        let new = readings.get(nightly.learned..).unwrap_or_default().to_vec();
        nightly.learned = readings.len();
        nightly.state.update(&nightly.periodicities, rules, new);
        Ok(nightly)
    }

    /// The predictions for the state at moments, which are in order of time.
    pub(super) fn known(&self, moments: &[Moment]) -> Vec<Known> {
        let plain = |probability: f64| Known { probability, looks: None };
        match (&self.trained, &self.nightly) {
            (Some(model), _) => moments.iter().map(|&at| plain(model.predict(at))).collect(),
            (None, Some(nightly)) => match nightly.state.predictive(&nightly.periodicities, moments) {
                Some(predicted) if self.kind == ModelKind::Ensemble => {
                    let known = predicted.into_iter();
                    known.map(|known| Known { probability: known.value(), looks: Some(known.bins()) }).collect()
                }
                _ => moments.iter().map(|&at| plain(nightly.spectral(at))).collect(),
            },
            (None, None) => vec![Known::default(); moments.len()],
        }
    }
}

/// The candidates of RAS 2017.
fn harmonics() -> Result<Periodicities, CannotTrain> {
    let refused = |_| CannotTrain::Parameter {
        parameter: "number of periodicities",
        found: f64::from(PERIOD_COUNT),
        expected: "1 to 2048",
    };
    Periodicities::harmonics(PERIOD_BASE_NANOS, PERIOD_COUNT).map_err(refused)
}

impl Nightly {
    /// Trains the members of the ensemble that are due, as a map does.
    fn train(&mut self, readings: &[Sample]) -> Result<(), CannotTrain> {
        let Some(newest) = readings.last() else { return Ok(()) };
        let oldest_nanos = newest.utc_nanos.saturating_sub(NIGHTLY_WINDOW_NANOS);
        let from = readings.partition_point(|reading| reading.utc_nanos < oldest_nanos);
        let window = readings.get(from..).unwrap_or(readings);
        for kind in TRAINED_AT_NIGHT {
            if kind.cost() == Some(TrainingCost::Low) && self.state.is_training_due(kind) {
                let trained = kind.train(Readings::new(window), StateKind::Probability, &self.periodicities)?;
                self.state = self.state.clone().with_trained(trained, newest.local_day());
            }
        }
        Ok(())
    }

    /// The probability by the spectral model.
    fn spectral(&self, at: Moment) -> f64 {
        self.state.spectral().predict(&self.periodicities, self.order(), at.civil_nanos())
    }

    /// The order up to [`ORDER_MAX`] that predicted best.
    fn order(&self) -> usize {
        let sums = self.state.errors().sums();
        let sums = sums.get(..=ORDER_MAX).unwrap_or(sums);
        let lowest = sums.iter().copied().fold(f64::INFINITY, f64::min);
        sums.iter().position(|&sum| sum <= lowest * NEAR_TIE).unwrap_or(0)
    }
}
