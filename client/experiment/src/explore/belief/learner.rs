//! Models of one state, trained every midnight to the readings of visits.
//!
//! Invariant: a state without readings has probability 0.5.

use tidemap_model::{
    OrderCriterion, Periodicities, Sample, StateModel,
    models::{
        Calibrated, CalibratedOptions, CannotFit, Histogram, HistogramCycle, HistogramSettings, Mean, Moment, Pergam,
        PergamOptions, Readings, TemporalModel,
    },
};

/// Maximum number of components of the spectral model.
const ORDER_MAX: usize = 8;
/// Candidate periodicities: the harmonics of four weeks down to two hours (RAS 2017, section 4.1.1).
const PERIOD_BASE_NANOS: i64 = 28 * 86_400 * 1_000_000_000;
const PERIOD_COUNT: u32 = 28 * 12;
/// The lowest order is chosen whose error is within this factor of the lowest error, as in a map.
const NEAR_TIE: f64 = 1.001;
/// Number of bins in a day.
const HISTOGRAM_BINS: usize = 24;

/// A kind of model of one state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LearnerKind {
    /// The mean of all readings: the long-term memory of RAS 2017.
    Mean,
    /// A Markov chain from the last reading on: the short-term memory of RAS 2017.
    Persistence,
    /// FreMEn, with the number of components up to eight that predicted best.
    Spectral,
    /// Three Gaussians over the day.
    Pergam,
    /// The mean of every hour of the day.
    Histogram,
    /// The calibrated profile of the week.
    Calibrated,
}

impl LearnerKind {
    /// All kinds.
    pub const ALL: [LearnerKind; 6] = [
        LearnerKind::Mean,
        LearnerKind::Persistence,
        LearnerKind::Spectral,
        LearnerKind::Pergam,
        LearnerKind::Histogram,
        LearnerKind::Calibrated,
    ];

    /// Its name in protocols.
    pub fn name(self) -> &'static str {
        match self {
            LearnerKind::Mean => "mean",
            LearnerKind::Persistence => "persistence",
            LearnerKind::Spectral => "spectral",
            LearnerKind::Pergam => "pergam",
            LearnerKind::Histogram => "histogram",
            LearnerKind::Calibrated => "calibrated",
        }
    }
}

/// A model of one state with its training data.
pub(super) struct Learner {
    kind: LearnerKind,
    fitted: Option<Box<dyn TemporalModel>>,
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
    pub(super) fn new(kind: LearnerKind) -> Learner {
        Learner { kind, fitted: None, spectral: None }
    }

    /// The kind of the model.
    pub(super) fn kind(&self) -> LearnerKind {
        self.kind
    }

    /// Trains on all readings; earlier ones must come first.
    pub(super) fn learn(&mut self, readings: &[Sample]) -> Result<(), CannotFit> {
        if readings.is_empty() {
            return Ok(());
        }
        let all = Readings::new(readings);
        self.fitted = match self.kind {
            LearnerKind::Mean => Some(Box::new(Mean::fit(all)?)),
            LearnerKind::Pergam => Some(Box::new(Pergam::fit(all, &PergamOptions::default())?)),
            LearnerKind::Histogram => {
                let settings = HistogramSettings::new(HistogramCycle::Day, HISTOGRAM_BINS);
                Some(Box::new(Histogram::fit(all, &settings)?))
            }
            LearnerKind::Calibrated => Some(Box::new(Calibrated::fit(all, CalibratedOptions::default())?)),
            LearnerKind::Spectral => {
                self.learn_spectral(readings)?;
                None
            }
            LearnerKind::Persistence => None,
        };
        Ok(())
    }

    fn learn_spectral(&mut self, readings: &[Sample]) -> Result<(), CannotFit> {
        let mut spectral = match self.spectral.take() {
            Some(spectral) => spectral,
            None => {
                let refused = |_| CannotFit::Parameter {
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
        match (&self.fitted, &self.spectral) {
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
