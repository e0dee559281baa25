//! Questions to a view: what a state is at given times, and how well a model tells given observations.
//!
//! Invariant: what leaves here lies in the bounds of its state's kind, a probability in [0, 1]. The phasors of a set of times are computed once and shared
//! by all states.

use std::{fmt, ops::RangeInclusive};

use tidemap_model::{
    InstantPhasors, ModelChoice, ORDER_MAX, OffsetCache, Persistence, PhasorTable, Sample, SpectralModel, StateKind,
    StateModel,
    models::{HistogramCycle, Moment, TemporalModel},
};

use crate::{event::StateId, grid::view::CellDescription, view::MapView};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 1440 * MINUTE_NANOS;

/// The periods that a periodic mixture of Gaussians may have, in nanoseconds: 1 minute to 366 days.
pub const PERGAM_PERIODS: RangeInclusive<i64> = MINUTE_NANOS..=366 * DAY_NANOS;
/// The period of one where none is said: a day, in nanoseconds.
pub const PERGAM_PERIOD_NANOS: i64 = DAY_NANOS;

/// Which model answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ModelKind {
    /// The model and order that the last update chose.
    #[default]
    Auto,
    /// The mean of the values folded in.
    Mean,
    /// The last acknowledged value; what an unlearned state answers before the first.
    Latest,
    /// The mean and the strongest spectral components (T-RO 2017, section III).
    Spectral,
    /// The Markov chain of two states, from the newest value on (RAS 2017, section 4.2).
    Persistence,
    /// The mean of each interval of a cycle (RA-L 2019, section IV).
    Histogram {
        /// What repeats.
        cycle: HistogramCycle,
        /// Intervals of the cycle; of weekday and weekend, of each.
        bins: u32,
    },
    /// Periodic mixture of Gaussians (ICRA 2015, eq. 5 to 7).
    Pergam {
        /// How many.
        gaussians: u32,
        /// The period, in nanoseconds of local civil time, within [`PERGAM_PERIODS`].
        period_nanos: i64,
    },
    /// Warped hypertime, by expectation maximisation (RA-L 2019, section III).
    HypertimeEm {
        /// How many.
        clusters: u32,
    },
    /// Warped hypertime, by k-means (RA-L 2019, section III).
    HypertimeKm {
        /// How many.
        clusters: u32,
    },
    /// A spectral model of the rate of counts.
    Poisson,
    /// Regression on the rhythms of day and week.
    Calibrated,
    /// The strongest components of the Fourier transform of regular readings, and the outliers that they miss (T-RO 2017,
    /// section III.B).
    Uniform,
}

impl ModelKind {
    /// Whether it has an order.
    #[must_use]
    pub fn has_order(self) -> bool {
        matches!(self, ModelKind::Auto | ModelKind::Spectral | ModelKind::Uniform)
    }

    /// Whether it has to be fitted to the readings of a state before it can answer.
    #[must_use]
    pub fn needs_readings(self) -> bool {
        !self.is_for_cells()
    }

    /// Whether cells of a grid have it too.
    #[must_use]
    pub fn is_for_cells(self) -> bool {
        matches!(self, ModelKind::Auto | ModelKind::Mean | ModelKind::Latest | ModelKind::Spectral)
    }
}

impl fmt::Display for ModelKind {
    /// As the command line names it, with its parameter.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Mean => f.write_str("mean"),
            Self::Latest => f.write_str("latest"),
            Self::Spectral => f.write_str("spectral"),
            Self::Persistence => f.write_str("persistence"),
            Self::Histogram { cycle: HistogramCycle::Day, bins } => write!(f, "histogram:{bins}"),
            Self::Histogram { cycle: HistogramCycle::Week, bins } => write!(f, "histogram:week:{bins}"),
            Self::Histogram { cycle: HistogramCycle::WeekdayWeekend, bins } => write!(f, "histogram:weekend:{bins}"),
            Self::Pergam { gaussians, period_nanos: PERGAM_PERIOD_NANOS } => write!(f, "pergam:{gaussians}"),
            Self::Pergam { gaussians, period_nanos } => write!(f, "pergam:{gaussians}:{}", Period(*period_nanos)),
            Self::HypertimeEm { clusters } => write!(f, "hypertime-em:{clusters}"),
            Self::HypertimeKm { clusters } => write!(f, "hypertime-km:{clusters}"),
            Self::Poisson => f.write_str("poisson"),
            Self::Calibrated => f.write_str("calibrated"),
            Self::Uniform => f.write_str("uniform"),
        }
    }
}

/// A period in nanoseconds, in the greatest unit that divides it: 7d, 36h, 90s; as the command line writes durations.
struct Period(i64);

impl fmt::Display for Period {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let units = [("d", DAY_NANOS), ("h", 60 * MINUTE_NANOS), ("m", MINUTE_NANOS), ("s", 1_000_000_000)];
        match units.into_iter().find(|(_, nanos)| self.0 % nanos == 0) {
            Some((unit, nanos)) => write!(f, "{}{unit}", self.0 / nanos),
            None => {
                let text = format!("{}.{:09}", self.0 / 1_000_000_000, self.0 % 1_000_000_000);
                write!(f, "{}s", text.trim_end_matches('0'))
            }
        }
    }
}

/// A model as a question names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// Which model.
    pub kind: ModelKind,
    /// Number of spectral components, at most [`ORDER_MAX`]; by default the order that the last update chose. Without
    /// effect on kinds that have none.
    pub order: Option<usize>,
    /// Blends the last value in (T-RO eq. 12 and 13).
    pub persistence: bool,
}

impl ModelSelector {
    /// Order of the spectral model that answers for this state; 0 for a constant one, and where another model answers.
    #[must_use]
    pub fn order_for(&self, model: &StateModel) -> usize {
        let is_other = self.kind == ModelKind::Auto && self.order.is_none() && model.choice() != ModelChoice::Spectral;
        if self.kind.has_order() && !is_other { self.order_or(model.order()) } else { 0 }
    }

    /// The order asked for, or else the one that the last update chose.
    #[must_use]
    pub(crate) fn order_or(&self, chosen: usize) -> usize {
        self.order.unwrap_or(chosen).min(ORDER_MAX)
    }

    /// Order of the spectral model that answers for this cell; 0 for a constant one.
    #[must_use]
    pub fn order_for_cell(&self, cell: &CellDescription) -> usize {
        if self.kind.has_order() { self.order_or(cell.order) } else { 0 }
    }
}

/// Times with their phasors, ready for any number of states of one map.
#[derive(Debug)]
pub struct PreparedTimes {
    moments: Vec<Moment>,
    phasors: PhasorTable,
}

impl PreparedTimes {
    /// Number of times.
    #[must_use]
    pub fn len(&self) -> usize {
        self.moments.len()
    }

    /// Whether there is no time.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.moments.is_empty()
    }

    /// The times, with the local time of the map.
    #[must_use]
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }
}

impl MapView {
    /// Computes the phasors of times in nanoseconds UTC. Memory: 16 bytes per time and candidate periodicity.
    #[must_use]
    pub fn prepare(&self, utc_nanos: &[i64]) -> PreparedTimes {
        let moments = self.moments(utc_nanos);
        let civil: Vec<i64> = moments.iter().map(|moment| moment.civil_nanos()).collect();
        PreparedTimes { moments, phasors: PhasorTable::new(&self.spec.periodicities, &civil) }
    }

    /// Times in nanoseconds UTC, with the local time of the map: what a model that was fitted to readings is asked with.
    #[must_use]
    pub fn moments(&self, utc_nanos: &[i64]) -> Vec<Moment> {
        let mut offsets = self.spec.zone.offset_cache();
        let moment = |&utc_nanos| Moment { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos) };
        utc_nanos.iter().map(moment).collect()
    }

    /// Probability that a state is 1, or the value to expect, at each of the moments, by a model that was fitted to its readings, written to `out`,
    /// which is as long as the moments.
    pub fn predict_fitted_into(
        &self,
        id: StateId,
        moments: &[Moment],
        fitted: &dyn TemporalModel,
        with_persistence: bool,
        out: &mut [f64],
    ) {
        let kind = self.kind(id);
        for (probability, &moment) in out.iter_mut().zip(moments) {
            // A sum of Gaussians or of components may be off by rounding.
            *probability = kind.saturate(fitted.predict(moment));
        }
        if with_persistence {
            blend(&self.live(id).persistence, self.model(id).usual_change(), moments, out);
        }
    }

    /// Probability that a state is 1, or the value to expect, at each of the times, written to `out`, which is as long as the times. A kind that
    /// has to be fitted to readings first ([`ModelKind::needs_readings`]) answers as [`ModelKind::Auto`] does.
    pub fn predict_into(&self, id: StateId, times: &PreparedTimes, selector: ModelSelector, out: &mut [f64]) {
        let model = self.model(id);
        let live = self.live(id);
        let chosen = if selector.kind == ModelKind::Auto && selector.order.is_none() { model.chosen() } else { None };
        match chosen {
            Some(chosen) => self.predict_fitted_into(id, &times.moments, &chosen, selector.persistence, out),
            None if selector.kind == ModelKind::Latest && live.persistence.last().is_none() => {
                out.fill(self.unlearned.of(model.kind()).spectral().mean());
            }
            None => {
                let parts = (model.spectral(), selector.order_for(model), &live.persistence);
                predict_state(model.kind(), parts, model.usual_change(), times, selector, out);
            }
        }
    }

    /// Probability that a cell is occupied at each of the times, written to `out`, which is as long as the times.
    pub fn predict_cell_into(
        &self,
        cell: &CellDescription,
        times: &PreparedTimes,
        selector: ModelSelector,
        out: &mut [f64],
    ) {
        let parts = (&cell.spectral, selector.order_for_cell(cell), &cell.persistence);
        predict_state(StateKind::Probability, parts, 1.0, times, selector, out);
    }

    /// The phasors of one time in nanoseconds UTC, for many cells.
    pub(crate) fn instant(&self, utc_nanos: i64) -> InstantPhasors {
        let civil = civil_nanos(&mut self.spec.zone.offset_cache(), utc_nanos);
        InstantPhasors::new(&self.spec.periodicities, civil)
    }

    /// Observations given from outside, on the map's civil time.
    pub fn sample_maker(&self) -> impl FnMut(i64, f64) -> Sample + use<> {
        let mut offsets = self.spec.zone.offset_cache();
        move |utc_nanos, value| Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
    }
}

fn civil_nanos(offsets: &mut OffsetCache, utc_nanos: i64) -> i64 {
    utc_nanos.saturating_add(i64::from(offsets.offset_secs(utc_nanos)) * 1_000_000_000)
}

fn predict_state(
    kind: StateKind,
    (spectral, order, persistence): (&SpectralModel, usize, &Persistence),
    usual_change: f64,
    times: &PreparedTimes,
    selector: ModelSelector,
    out: &mut [f64],
) {
    match selector.kind {
        ModelKind::Mean => out.fill(kind.saturate(spectral.mean())),
        ModelKind::Latest => out.fill(persistence.last().map_or_else(|| kind.unlearned(), |(_, value)| value)),
        _ => spectral.predict_values_into(kind, order, &times.phasors, out),
    }
    if selector.persistence {
        blend(persistence, usual_change, &times.moments, out);
    }
}

fn blend(persistence: &Persistence, usual_change: f64, moments: &[Moment], out: &mut [f64]) {
    for (probability, moment) in out.iter_mut().zip(moments) {
        *probability = persistence.blend_of(usual_change, *probability, moment.utc_nanos);
    }
}
