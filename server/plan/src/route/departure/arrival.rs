//! The latest departure that is expected to arrive in time.
//!
//! Invariant: the found departure is in time, and all later ones that were tried are not.

use super::{Departure, Planner};
use crate::route::{
    DEPARTURES_MAX, Forecasts, Objective, PlanRouteError,
    bounds::{Source, ToGo},
    cost::{Cost, Costing},
};

/// The precision of a departure, in seconds.
const STEP_MIN_SECS: f64 = 0.1;

impl<F: Forecasts, U: FnMut() -> bool> Planner<'_, F, U> {
    /// The last departure that is expected to arrive in time: first by steps backwards, then refined forwards. After a
    /// departure D with duration E, tries T - E, and if that is too late, the midpoint.
    pub(super) fn arriving(&mut self, by_secs: f64, earliest_secs: f64) -> Result<Option<Departure>, PlanRouteError> {
        let first_secs = earliest_secs.max(by_secs - self.options.horizon_secs);
        if first_secs > by_secs {
            self.is_late = true;
            return Ok(None);
        }
        let step_secs = self.work.arrival_step_secs.max((by_secs - first_secs) / (DEPARTURES_MAX - 1) as f64);
        let departures = (first_secs, by_secs);
        let mut later_secs = by_secs;
        let mut in_time = None;
        let least_secs = self.least_secs(departures)?;
        let first_step = ((least_secs * (1.0 - 1e-9) / step_secs) as usize).clamp(1, DEPARTURES_MAX);
        for step in first_step..=DEPARTURES_MAX {
            let secs = (by_secs - step as f64 * step_secs).max(first_secs);
            in_time = self.arrives(secs, departures, by_secs)?;
            if in_time.is_some() || secs <= first_secs {
                break;
            }
            if (self.until)() {
                self.marks.stopped = true;
                break;
            }
            later_secs = secs;
        }
        let Some((mut best, mut spare_secs)) = in_time else { return Ok(None) };
        while spare_secs > STEP_MIN_SECS && later_secs - best.secs > STEP_MIN_SECS {
            let next = best.secs + spare_secs;
            let next = if next < later_secs { next } else { 0.5 * (best.secs + later_secs) };
            match self.arrives(next, departures, by_secs)? {
                Some(found) => (best, spare_secs) = found,
                None => {
                    later_secs = next;
                    spare_secs = 0.5 * (next - best.secs);
                }
            }
        }
        Ok(Some(best))
    }

    /// Lower bound of the expected duration of all paths that end at the last of some times; as reliable as the bounds.
    fn least_secs(&mut self, (first_secs, by_secs): (f64, f64)) -> Result<f64, PlanRouteError> {
        let known = self.depart(by_secs, (first_secs, by_secs), Cost::INFINITE)?;
        self.is_late |= known.is_some();
        let (source, span) = match (self.samples_bounds, known) {
            (true, Some(departure)) => {
                let (steps, _) = self.walk(by_secs, &departure.found.edges)?;
                let secs: f64 = steps.iter().map(|step| step.expected_secs).sum();
                (Source::Sampled(self.work.samples), (by_secs - 2.0 * secs, by_secs))
            }
            (true, None) => return Ok(0.0),
            _ => (Source::Known, (first_secs, by_secs)),
        };
        // The costs are the time alone, without encounters and failures.
        let costing = Costing { objective: Objective::Time, encounter_cost_secs: 0.0, ..self.cache.costing };
        self.cache.bounds = Some(costing);
        let to_go = ToGo::find(self.network, &mut self.cache, self.goal, span, source, Cost::INFINITE);
        self.cache.bounds = None;
        let least_secs = to_go?.least[self.start].first;
        Ok(if least_secs.is_finite() { least_secs } else { 0.0 })
    }

    /// The best path of a departure with its spare time, if it is expected to arrive in time.
    fn arrives(
        &mut self,
        secs: f64,
        departures: (f64, f64),
        by_secs: f64,
    ) -> Result<Option<(Departure, f64)>, PlanRouteError> {
        let Some(departure) = self.depart(secs, departures, Cost::INFINITE)? else { return Ok(None) };
        let (steps, _) = self.walk(secs, &departure.found.edges)?;
        let spare_secs = by_secs - secs - steps.iter().map(|step| step.expected_secs).sum::<f64>();
        self.is_late |= spare_secs < 0.0;
        Ok((spare_secs >= 0.0).then_some((departure, spare_secs)))
    }
}
