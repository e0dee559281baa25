//! What is to be expected of an edge of the topological map: how likely it is passed, how sure that is, how long it takes.
//!
//! An edge is learned from few reports, most of them from hours at which robots used it. Three things are put together, the
//! nearer evidence outweighing the farther as it grows: what the edges of the map have in common, what the edge's own
//! temporal model predicts, and what was reported at about that hour of the week. Each counts as a few reports for the
//! next, the model as more where the hours of the edge do not seem to differ (`forecast/hour_uniformity.rs`), so that a probability is the mean of a Beta distribution, and is never 0: an edge that counts as impassable would
//! never be tried again, as happened to robots (STRANDS, IEEE RAM 2017, "Adaptive Topological Navigation").
//! Invariant: a success lies in `[LEARNED_SUCCESS_MIN, 1)`, evidence is above 0, a duration is above 0 and finite.

use tidemap_model::models::{HourTable, Moment};

use crate::{
    ids::StateId,
    topology::{Extent, NOMINAL_MAX_SECS},
    view::MapView,
};

mod edges;
mod hour_uniformity;

#[cfg(test)]
mod tests;

pub use edges::EdgeForecasts;

/// No edge is less likely to be passed.
pub const LEARNED_SUCCESS_MIN: f64 = 0.001;
/// Chance that an edge is passed in a map of which nothing was reported, and as how many reports that counts.
const SUCCESS_PRIOR: (f64, f64) = (0.9, 10.0);
/// As how many reports the map counts for an edge, and the edge's model at least for an hour of the week.
const PRIOR_REPORTS: f64 = 2.0;
/// What a report counts at an hour of the day so many hours away.
const NEAR_HOURS: [f64; 3] = [1.0, 0.2, 0.05];
/// What a report of another day of the week counts, of the same kind (weekday, weekend) and of the other.
const OTHER_DAY: [f64; 2] = [0.7, 0.3];
/// An edge is at most so much faster, and so much slower, than edges usually are.
const SPEED_RATIO_MAX: f64 = 20.0;
const HOUR_NANOS: i64 = 3_600_000_000_000;
/// 1970-01-01 was a Thursday; weeks begin on Monday.
const EPOCH_HOUR_OF_WEEK: i64 = 3 * 24;
const DAY_HOURS: usize = 24;
const WEEK_HOURS: usize = 168;

/// The forecast of an edge at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeForecast {
    /// Probability that an attempt succeeds.
    pub success: f64,
    /// Number of reports that `success` is worth, above 0: the probability is believed to follow
    /// Beta(success · evidence, (1 - success) · evidence).
    pub evidence: f64,
    /// Duration of a successful attempt, in seconds, above 0, at most [`NOMINAL_MAX_SECS`].
    pub duration_secs: f64,
}

/// The states that tell of an edge; none before its first report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EdgeStates {
    /// Whether it was passed.
    pub success: Option<StateId>,
    /// How fast: metres a second of an edge with a length, else nominal seconds a second.
    pub travel: Option<StateId>,
}

/// What the edges of a map have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePrior {
    /// Probability that an edge is passed.
    pub success: f64,
    /// Metres a second.
    pub speed_m_per_s: f64,
    /// Nominal seconds a second.
    pub pace: f64,
}

impl EdgePrior {
    /// Means over all reports that updates have folded in. `speed_m_per_s`: the speed as long as none was reported, above 0.
    #[must_use]
    pub fn of(view: &MapView, edges: impl IntoIterator<Item = (Extent, EdgeStates)>, speed_m_per_s: f64) -> EdgePrior {
        let (chance, weight) = SUCCESS_PRIOR;
        let mut success = [chance * weight, weight];
        let mut speed = [speed_m_per_s * PRIOR_REPORTS, PRIOR_REPORTS];
        let mut pace = [PRIOR_REPORTS, PRIOR_REPORTS];
        let folded = |id: Option<StateId>| {
            let folded = id.map(|id| view.model(id).accumulator()).filter(|folded| folded.observations() > 0);
            folded.map_or([0.0, 0.0], |folded| [folded.mean() * folded.weight(), folded.weight()])
        };
        let add = |sums: &mut [f64; 2], more: [f64; 2]| *sums = [sums[0] + more[0], sums[1] + more[1]];
        for (extent, states) in edges {
            add(&mut success, folded(states.success));
            add(if extent.length_m.is_some() { &mut speed } else { &mut pace }, folded(states.travel));
        }
        let mean = |[sum, weight]: [f64; 2]| sum / weight;
        let above = |value: f64, otherwise: f64| if value > 0.0 && value.is_finite() { value } else { otherwise };
        EdgePrior {
            success: mean(success).clamp(LEARNED_SUCCESS_MIN, 1.0 - f64::EPSILON),
            speed_m_per_s: above(mean(speed), speed_m_per_s),
            pace: above(mean(pace), 1.0),
        }
    }
}

/// What was reported of an edge.
#[derive(Clone, Debug)]
pub struct EdgeRecord {
    extent: Extent,
    /// Reports of passing or failing, and of speeds, that updates have folded in, by weight.
    tried: f64,
    travelled: f64,
    /// By hour of the week, the weight of reports at about that hour and how many of them passed; none without any.
    by_hour: Option<Box<[[f64; 2]; WEEK_HOURS]>>,
    /// As how many reports the edge as a whole counts for an hour.
    hour_uniformity: f64,
}

impl EdgeRecord {
    /// What the map knows of an edge of this extent, by its states.
    #[must_use]
    pub fn of(view: &MapView, extent: Extent, states: EdgeStates, prior: &EdgePrior) -> EdgeRecord {
        let weight = |id: Option<StateId>| id.map_or(0.0, |id| view.model(id).accumulator().weight());
        let table = states.success.and_then(|id| view.model(id).alternatives()).map(|known| known.hours());
        EdgeRecord {
            extent,
            tried: weight(states.success),
            travelled: weight(states.travel),
            by_hour: table.map(near_hours),
            hour_uniformity: table
                .map_or(PRIOR_REPORTS, |table| hour_uniformity::hour_uniformity(table, prior.success)),
        }
    }

    /// What is to be expected at a moment. `success` and `travel`: what the models of the edge's states predict for it; of no
    /// meaning where there is no such state.
    #[must_use]
    pub fn forecast(&self, prior: &EdgePrior, success: f64, travel: f64, at: Moment) -> EdgeForecast {
        let blend =
            |weight: f64, value: f64, before: f64| (weight * value + PRIOR_REPORTS * before) / (weight + PRIOR_REPORTS);
        let model = blend(self.tried, finite_or(success, prior.success).clamp(0.0, 1.0), prior.success);
        let [tried, passed] = self.by_hour.as_ref().map_or([0.0, 0.0], |hours| hours[hour_of_week(at)]);
        let weight = self.tried.min(self.hour_uniformity) + PRIOR_REPORTS;
        let success = (weight * model + passed) / (weight + tried);
        EdgeForecast {
            success: success.clamp(LEARNED_SUCCESS_MIN, 1.0 - 1e-9),
            evidence: weight + tried,
            duration_secs: self.duration_secs(prior, |before| blend(self.travelled, finite_or(travel, before), before)),
        }
    }

    fn duration_secs(&self, prior: &EdgePrior, speed: impl Fn(f64) -> f64) -> f64 {
        let (extent, before) = match (self.extent.length_m, self.extent.nominal_secs) {
            // A nominal time says more of an edge than the speed of others.
            (Some(length_m), Some(secs)) => (length_m, length_m / secs * prior.pace),
            (Some(length_m), None) => (length_m, prior.speed_m_per_s),
            (None, secs) => (secs.unwrap_or(1.0), prior.pace),
        };
        let speed = speed(before).clamp(before / SPEED_RATIO_MAX, before * SPEED_RATIO_MAX);
        (extent / speed).clamp(1e-9, NOMINAL_MAX_SECS)
    }
}

fn finite_or(value: f64, otherwise: f64) -> f64 {
    if value.is_finite() { value } else { otherwise }
}

fn hour_of_week(at: Moment) -> usize {
    let hour = (at.civil_nanos().div_euclid(HOUR_NANOS) + EPOCH_HOUR_OF_WEEK).rem_euclid(WEEK_HOURS as i64);
    usize::try_from(hour).unwrap_or(0)
}

/// What was read at about each hour of the week: `[weight, sum]`.
fn near_hours(table: &HourTable) -> Box<[[f64; 2]; WEEK_HOURS]> {
    let mut near = Box::new([[0.0; 2]; WEEK_HOURS]);
    // Around each hour first, within the week that goes on at its end; then over the days.
    for hour in 0..WEEK_HOURS {
        for (away, weight) in NEAR_HOURS.into_iter().enumerate() {
            // Before and after; the hour itself once.
            let others = [hour + away, hour + WEEK_HOURS - away];
            for other in others.into_iter().take(if away == 0 { 1 } else { 2 }) {
                let [count, sum] = table.readings(other % WEEK_HOURS);
                near[hour][0] += weight * count;
                near[hour][1] += weight * sum;
            }
        }
    }
    let around = near.clone();
    for (at, near) in near.iter_mut().enumerate() {
        let (day, hour) = (at / DAY_HOURS, at % DAY_HOURS);
        for other in (0..WEEK_HOURS / DAY_HOURS).filter(|&other| other != day) {
            let weight = OTHER_DAY[usize::from((day >= 5) != (other >= 5))];
            let [count, sum] = around[other * DAY_HOURS + hour];
            near[0] += weight * count;
            near[1] += weight * sum;
        }
    }
    near
}
