//! The forecast of an edge of the topological map: its success probability, the evidence for it, and its duration.
//!
//! An edge is learned from few reports, most of them at hours at which robots used it. Its forecast combines three
//! sources: the means over all edges of the map, the edge's own temporal model, and the reports at about that hour of
//! the week. More specific sources gain weight as reports accumulate; at an hour without reports the model's
//! prediction, which follows from other hours alone, is drawn to the map's mean. Models forget hours at which a route
//! avoids the edge; the reports of these hours stay. The model counts more if the hours of the edge do not differ
//! (`edge_forecast/hour_uniformity.rs`). A probability is the mean of a Beta distribution, so it never reaches 0: a
//! robot would never retry an edge that counts as impassable (STRANDS, IEEE RAM 2017, "Adaptive Topological
//! Navigation").
//!
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

/// Lowest success probability of a learned forecast.
pub(crate) const LEARNED_SUCCESS_MIN: f64 = 0.001;
/// Success probability of an edge in a map without reports, and its weight in reports.
const SUCCESS_PRIOR: (f64, f64) = (0.9, 10.0);
/// Weight, in reports, of the map as the prior of an edge, and minimum weight of the edge's model as the prior of an
/// hour of the week.
const PRIOR_REPORTS: f64 = 2.0;
/// Weight, in reports, that a report at about an hour adds to the edge's model against the map's mean at that hour. It
/// was chosen with the seeds 100 to 107 of `tidemap-research routes`, among 1, 4, 16 and 64.
const MODEL_PER_REPORT: f64 = 16.0;
/// Weight of a report that is 0, 1 or 2 hours of the day away.
const NEAR_HOURS: [f64; 3] = [1.0, 0.2, 0.05];
/// Weight of a report of another day of the week: of a day of the same kind (weekday, weekend), and of the other kind.
const OTHER_DAY: [f64; 2] = [0.7, 0.3];
/// Maximum ratio between the speed of an edge and the usual speed, both ways.
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

/// The states that learn from traversals of an edge; none before its first report.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EdgeStates {
    /// State of whether the edge was passed.
    pub success: Option<StateId>,
    /// State of the speed in metres per second for an edge with a length, otherwise of nominal time over time taken.
    pub travel: Option<StateId>,
}

/// Means over the edges of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePrior {
    /// Probability that an edge is passed.
    pub success: f64,
    /// Speed, metres per second.
    pub speed_m_per_s: f64,
    /// Pace, nominal seconds per second.
    pub pace: f64,
}

impl EdgePrior {
    /// Means over all reports that updates have learned. `speed_m_per_s`: the speed without reports, above 0.
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

/// The reports of an edge.
#[derive(Clone, Debug)]
pub struct EdgeRecord {
    extent: Extent,
    /// Weight of the learned reports of success or failure, and of speeds.
    tried: f64,
    travelled: f64,
    /// For each hour of the week: the weight of the reports at about that hour, and the weight of the reports of
    /// success; `None` without reports.
    by_hour: Option<Box<[[f64; 2]; WEEK_HOURS]>>,
    /// Weight, in reports, of the edge as a whole as the prior of one of its hours.
    hour_uniformity: f64,
}

impl EdgeRecord {
    /// The record of an edge of this extent, from its states.
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

    /// The forecast for a moment. `success` and `travel` are the predictions of the models of the edge's states; they
    /// are ignored for a state that does not exist.
    pub fn forecast(&self, prior: &EdgePrior, success: f64, travel: f64, at: Moment) -> EdgeForecast {
        let blend =
            |weight: f64, value: f64, before: f64| (weight * value + PRIOR_REPORTS * before) / (weight + PRIOR_REPORTS);
        let [tried, passed] = self.by_hour.as_ref().map_or([0.0, 0.0], |hours| hours[hour_of_week(at)]);
        // The prediction of the model for an hour without reports follows from other hours alone.
        let known = self.tried.min(self.hour_uniformity + MODEL_PER_REPORT * tried);
        let model = blend(known, finite_or(success, prior.success).clamp(0.0, 1.0), prior.success);
        let weight = self.tried.min(self.hour_uniformity) + PRIOR_REPORTS;
        let success = (weight * model + passed) / (weight + tried);
        let forecast = EdgeForecast {
            success: success.clamp(LEARNED_SUCCESS_MIN, 1.0 - 1e-9),
            evidence: weight + tried,
            duration_secs: self.duration_secs(prior, |before| blend(self.travelled, finite_or(travel, before), before)),
        };
        debug_assert!(forecast.evidence > 0.0, "{forecast:?}");
        debug_assert!(forecast.duration_secs > 0.0 && forecast.duration_secs.is_finite(), "{forecast:?}");
        forecast
    }

    fn duration_secs(&self, prior: &EdgePrior, speed: impl Fn(f64) -> f64) -> f64 {
        let (extent, before) = match (self.extent.length_m, self.extent.nominal_secs) {
            // A nominal time is better evidence than the speed of other edges.
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

/// The readings at about each hour of the week: `[weight, sum]`.
fn near_hours(table: &HourTable) -> Box<[[f64; 2]; WEEK_HOURS]> {
    let mut near = Box::new([[0.0; 2]; WEEK_HOURS]);
    // The sums are first over the hours around each hour, wrapping at the end of the week, then over the days.
    for hour in 0..WEEK_HOURS {
        for (away, weight) in NEAR_HOURS.into_iter().enumerate() {
            // The hours before and after count; the hour itself counts only once.
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
