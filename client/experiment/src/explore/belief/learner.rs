//! Models of one state, trained every midnight on the readings of visits.
//!
//! Invariant: a state without readings has probability 0.5.

use tidemap_model::{
    OrderCriterion, Periodicities, Sample, StateKind, StateModel, TrainedModel,
    catalogue::{ModelKind, TrainingCost},
    models::{CannotTrain, Moment, Readings, TemporalModel},
};

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
    spectral: Option<Spectral>,
}

/// The spectral model, which learns incrementally.
struct Spectral {
    periodicities: Periodicities,
    state: StateModel,
    learned: usize,
}

impl Learner {
    /// An untrained model.
    pub(super) fn new(kind: ModelKind) -> Learner {
        Learner { kind, trained: None, spectral: None }
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
                self.learn_spectral(readings)?;
                None
            }
            SHORT_TERM => None,
            kind => Some(kind.train(Readings::new(readings), StateKind::Probability, &Periodicities::default())?),
        };
        Ok(())
    }

    fn learn_spectral(&mut self, readings: &[Sample]) -> Result<(), CannotTrain> {
        let mut spectral = match self.spectral.take() {
            Some(spectral) => spectral,
            None => {
                let refused = |_| CannotTrain::Parameter {
                    parameter: "number of periodicities",
                    found: f64::from(PERIOD_COUNT),
                    expected: "1 to 2048",
                };
                let periodicities = Periodicities::harmonics(PERIOD_BASE_NANOS, PERIOD_COUNT).map_err(refused)?;
                Spectral { state: StateModel::new(&periodicities), periodicities, learned: 0 }
            }
        };
        let new = readings.get(spectral.learned..).unwrap_or_default().to_vec();
        spectral.learned = readings.len();
        spectral.state.update(&spectral.periodicities, OrderCriterion::SquaredError, new);
        self.spectral = Some(spectral);
        Ok(())
    }

    /// The predicted probability at a moment.
    pub(super) fn probability(&self, at: Moment) -> f64 {
        match (&self.trained, &self.spectral) {
            (Some(model), _) => model.predict(at),
            (None, Some(spectral)) => {
                let model = spectral.state.spectral();
                model.predict(&spectral.periodicities, spectral.order(), at.civil_nanos())
            }
            (None, None) => 0.5,
        }
    }
}

impl Spectral {
    /// The order up to [`ORDER_MAX`] that predicted best.
    fn order(&self) -> usize {
        let sums = self.state.errors().sums();
        let sums = sums.get(..=ORDER_MAX).unwrap_or(sums);
        let lowest = sums.iter().copied().fold(f64::INFINITY, f64::min);
        sums.iter().position(|&sum| sum <= lowest * NEAR_TIE).unwrap_or(0)
    }
}
