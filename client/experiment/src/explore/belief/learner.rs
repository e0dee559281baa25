//! Models of one state, learned again every midnight from readings that came when the state was visited.
//!
//! Invariant: a state of which nothing was read has probability 0.5.

use tidemap_model::{
    OrderCriterion, Periodicities, Sample, StateModel,
    models::{
        Calibrated, CalibratedOptions, CannotFit, Histogram, HistogramCycle, HistogramSettings, Mean, Moment, Pergam,
        PergamOptions, Readings, TemporalModel,
    },
};

/// The most components that the spectral model uses.
const ORDER_MAX: usize = 8;
/// ParameterSet periodicities: the harmonics of four weeks down to two hours (RAS 2017, section 4.1.1).
const PERIOD_BASE_NANOS: i64 = 28 * 86_400 * 1_000_000_000;
const PERIOD_COUNT: u32 = 28 * 12;
/// A lower order wins where its error exceeds the lowest by no more than this factor, as in a map.
const NEAR_TIE: f64 = 1.001;
/// Bins of the day.
const HISTOGRAM_BINS: usize = 24;

/// A kind of model of one state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LearnerKind {
    /// The mean of all readings: the long-term memory of RAS 2017.
    Mean,
    /// A Markov chain from the newest reading on: its short-term memory.
    Persistence,
    /// FreMEn, with up to eight components, as many as have predicted best.
    Spectral,
    /// Three Gaussians over the day.
    Pergam,
    /// The mean of every hour of the day.
    Histogram,
    /// The calibrated profile of the week.
    Calibrated,
}

impl LearnerKind {
    /// All of them.
    pub const ALL: [LearnerKind; 6] = [
        LearnerKind::Mean,
        LearnerKind::Persistence,
        LearnerKind::Spectral,
        LearnerKind::Pergam,
        LearnerKind::Histogram,
        LearnerKind::Calibrated,
    ];

    /// As people write it.
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

/// A model of one state with what it has learned.
pub struct Learner {
    kind: LearnerKind,
    fitted: Option<Box<dyn TemporalModel>>,
    spectral: Option<Spectral>,
}

/// The spectral model, which learns day by day.
struct Spectral {
    periodicities: Periodicities,
    state: StateModel,
    learned: usize,
}

impl Learner {
    /// That has learned nothing.
    pub fn new(kind: LearnerKind) -> Learner {
        Learner { kind, fitted: None, spectral: None }
    }

    /// Which it is.
    pub fn kind(&self) -> LearnerKind {
        self.kind
    }

    /// Learns all readings there are; those that it knows come first.
    pub fn learn(&mut self, readings: &[Sample]) -> Result<(), CannotFit> {
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

    /// The probability at a moment.
    pub fn probability(&self, at: Moment) -> f64 {
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
    /// The order up to [`ORDER_MAX`] that has predicted best.
    fn order(&self) -> usize {
        let sums = self.state.errors().sums();
        let sums = sums.get(..=ORDER_MAX).unwrap_or(sums);
        let lowest = sums.iter().copied().fold(f64::INFINITY, f64::min);
        sums.iter().position(|&sum| sum <= lowest * NEAR_TIE).unwrap_or(0)
    }
}
