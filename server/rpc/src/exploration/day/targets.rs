//! The expected information of the targets of a day, slot by slot.
//!
//! Invariant: the gains have a column per name, and a row per slot.

use std::{ops::ControlFlow, sync::Arc};

use tidemap_answer::StateOrCell;
use tidemap_model::StopSignal;
use tidemap_plan::{
    day::DayError,
    predicted::{PredictOptions, PredictedGrid, PredictedTimes},
    strategy::Gains,
    tour::{NoTour, Tour, plan_tour_around},
    view::{SceneOptions, Sensor, TimedScene, Viewpoint, view_many},
};
use tidemap_proto::convert::exploration::{DayTargets, TourRequest};

use super::{
    super::{
        Explorations,
        locations::{Locations, find_locations},
        presence::predict_presence,
        tour::starting_on,
        worth::look_worths,
    },
    Day,
};
use crate::{
    lookup::check_limit,
    permits::run_while_awaited,
    series::predict_series,
    status::{PlanError, RpcError},
};

impl Day<'_> {
    /// The names of the targets, and the expected information of each in each slot.
    pub(super) async fn information(&self) -> Result<(Vec<String>, Gains), RpcError> {
        match &self.question.targets {
            DayTargets::Tour(tour) => Ok((vec!["tour".to_owned()], self.tour_gains(tour.clone()).await?)),
            DayTargets::Views { viewpoints, sensor, scene } => {
                let names = viewpoints.iter().map(|at| format!("{},{}", at.x_m, at.y_m)).collect();
                Ok((names, self.view_gains(viewpoints.clone(), *sensor, *scene).await?))
            }
            DayTargets::ExactlyOne(names) => {
                let locations = find_locations(self.view, names, self.explorations.limits.predictions).await?;
                let times = (self.question.slot_nanos, self.middles.clone());
                let rows = predict_presence(self.explorations, self.handle, self.view, &locations, times).await?;
                self.location_gains(locations, &rows).await
            }
            DayTargets::Locations(names) => {
                let locations = find_locations(self.view, names, self.explorations.limits.predictions).await?;
                let states: Vec<StateOrCell> = locations.members.iter().flatten().cloned().collect();
                let (context, requested) = (self.explorations.predict_context(), (states, self.middles.clone()));
                let rows = predict_series(context, self.handle, self.view, requested, self.question.selector).await?;
                self.location_gains(locations, &rows).await
            }
        }
    }

    /// The expected information of locations. `rows` has the probabilities of their states, in the order of the
    /// locations.
    async fn location_gains(&self, locations: Locations, rows: &[Vec<f64>]) -> Result<(Vec<String>, Gains), RpcError> {
        let counts: Vec<usize> = locations.members.iter().map(Vec::len).collect();
        let requested = (locations.members.into_iter().flatten().collect(), self.middles.as_slice());
        let bits = look_worths(self.explorations, self.view, requested, rows, self.question.worth).await?;
        let gains = gains(&bits, &counts, self.middles.len()).map_err(PlanError::from)?;
        Ok((locations.names, gains))
    }

    /// The expected information of each viewpoint, times the probability of reaching it.
    async fn view_gains(
        &self,
        viewpoints: Vec<Viewpoint>,
        sensor: Sensor,
        scene: SceneOptions,
    ) -> Result<Gains, RpcError> {
        let (explorations, middles) = (self.explorations, self.middles.clone());
        let cells = viewpoints.len() as u64 * middles.len() as u64;
        check_limit("viewpoints x slots", cells, explorations.limits.predictions, "setting max_predictions")?;
        let options = PredictOptions { selector: self.question.selector, ..explorations.predict_options() };
        let (limits, view) = (explorations.look_limits(), Arc::clone(self.view));
        let work = move |stop: StopSignal<'_>| {
            let grid = PredictedTimes::new(&view, &middles, &options, stop)?;
            let scene = TimedScene::new(&grid, &scene, stop)?;
            let reachability = view.site().reachability();
            let mut rows: Vec<Vec<f64>> = Vec::with_capacity(viewpoints.len());
            view_many(&scene, &sensor, &viewpoints, limits, stop, |number, seen| {
                let at = viewpoints.get(number).copied().unwrap_or_default();
                let rate = reachability.rate(at.x_m, at.y_m).rate;
                let bits = seen.unwrap_or_else(|_| vec![None; middles.len()]);
                rows.push(bits.into_iter().map(|bits| rate * bits.unwrap_or(0.0)).collect());
                ControlFlow::Continue(())
            })?;
            let gains = Gains::of(middles.len(), rows.len(), |slot, place| rows[place][slot]);
            gains.map_err(|error| PlanError::Day(error.into()))
        };
        Ok(run_while_awaited(explorations.permits.take().await?, None, work).await??)
    }

    /// The expected information of the whole tour of each slot, its goals weighted by their reachability (RA-L 2016,
    /// section III.F); 0 where no tour is worth it.
    ///
    /// # Errors
    /// Also if no slot has a tour because the robot cannot leave or reach anything.
    async fn tour_gains(&self, tour: TourRequest) -> Result<Gains, RpcError> {
        let (explorations, middles) = (self.explorations, self.middles.clone());
        Explorations::check_grid_times(&middles)?;
        let (question, view) = (starting_on(self.view, tour)?, Arc::clone(self.view));
        let options = PredictOptions { selector: self.question.selector, ..explorations.predict_options() };
        let work = move |stop: StopSignal<'_>| {
            let tour = |&time_nanos: &i64| {
                let grid = PredictedGrid::new(&view, time_nanos, &options, stop)?;
                Ok::<_, PlanError>(plan_tour_around(
                    &grid,
                    (view.site().reachability(), view.site().no_go()),
                    &question,
                    stop,
                )?)
            };
            let tours = middles.iter().map(tour).collect::<Result<Vec<Tour>, PlanError>>()?;
            if let Some(reason) = never_possible(&tours) {
                return Err(PlanError::NoTour(reason));
            }
            Gains::of(tours.len(), 1, |slot, _| tours[slot].expected_bits).map_err(|error| PlanError::Day(error.into()))
        };
        Ok(run_while_awaited(explorations.permits.take().await?, None, work).await??)
    }
}

/// The reason why the robot cannot make a tour in any slot; `None` if it can, or if there is nothing to learn at some
/// time.
fn never_possible(tours: &[Tour]) -> Option<NoTour> {
    let is_impossible = |tour: &Tour| tour.no_tour.is_some_and(|reason| reason != NoTour::NothingToLearn);
    tours.first().filter(|_| tours.iter().all(is_impossible))?.no_tour
}

/// The expected information of each location in each slot. `rows` has the information of the states of the locations,
/// in the order of the locations.
fn gains(rows: &[Vec<f64>], counts: &[usize], slots: usize) -> Result<Gains, DayError> {
    let mut begin = 0;
    let of_location: Vec<&[Vec<f64>]> = counts
        .iter()
        .map(|count| {
            begin += count;
            &rows[begin - count..begin]
        })
        .collect();
    let gain = |slot: usize, place: usize| of_location[place].iter().map(|row| row[slot]).sum();
    Ok(Gains::of(slots, counts.len(), gain)?)
}
