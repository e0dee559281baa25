//! `PlanDay`: which slots of a day to explore, and where.
//!
//! Invariant: the information of a slot is predicted for its middle; a plan has a row per slot of the local day.

use std::{ops::ControlFlow, sync::Arc};

use tidemap_map::{event::StateKind, view::MapView};
use tidemap_model::{StopSignal, selector::ModelSelector};
use tidemap_plan::{
    day::{DaySlots, plan_day as plan},
    information::Certainty,
    predicted::{PredictOptions, PredictedGrid, PredictedTimes},
    strategy::Gains,
    tour::{NoTour, Tour, plan_tour},
    view::{SceneOptions, Sensor, TimedScene, Viewpoint, view_many},
};
use tidemap_proto::{
    convert::{
        InvalidField,
        exploration::{
            budget_from_wire, certainty_from_wire, date_from_wire, day_to_wire, scene_from_wire, sensor_from_wire,
            slot_from_wire, strategy_from_wire, viewpoint_from_wire,
        },
        query::{check_for_cells, selector_from_wire},
    },
    v1,
};

use super::{Explorations, information::members, presence::predict_presence, tour::tour_question};
use crate::{
    rpc::{
        lookup::{check_limit, find_map, find_state},
        permits::run_while_awaited,
        series::{check_kind, predict_series},
        status::{PlanError, RpcError},
    },
    state_or_cell::StateOrCell,
};

/// Maximum number of locations of one request.
const LOCATIONS_MAX: usize = 10_000;

/// The locations to choose from, by name, with their states and cells, at most `max` of these.
pub(super) async fn locations(
    view: &Arc<MapView>,
    asked: Vec<String>,
    max: u64,
) -> Result<(Vec<String>, Vec<Vec<StateOrCell>>), RpcError> {
    let names = if asked.is_empty() {
        view.site().locations().keys().map(|name| name.as_str().to_owned()).collect()
    } else {
        asked
    };
    check_limit("locations", names.len() as u64, LOCATIONS_MAX as u64, "one request")?;
    if !names.is_empty() {
        let states = members(view, &names, max).await?;
        return Ok((names, states));
    }
    let is_probability = |info: &&tidemap_map::view::StateInfo| info.kind == StateKind::Probability;
    let names: Vec<String> = view.infos().filter(is_probability).map(|info| info.name.as_str().to_owned()).collect();
    check_limit("states", names.len() as u64, LOCATIONS_MAX as u64, "one request without locations")?;
    if names.is_empty() {
        return Err(InvalidField::new("locations", "the map has neither locations nor states to explore").into());
    }
    let states = names.iter().map(|name| find_state(view, name).map(|id| vec![id.into()])).collect::<Result<_, _>>()?;
    Ok((names, states))
}

pub(super) async fn plan_day(
    explorations: &Explorations,
    request: v1::PlanDayRequest,
) -> Result<v1::PlanDayResponse, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let view = handle.view();
    let day = date_from_wire("date", &request.date)?;
    let slot_nanos = slot_from_wire(request.slot)?;
    let slots = DaySlots::of(&view.spec().zone, day, slot_nanos).map_err(PlanError::from)?;
    let (budget, strategy) = (budget_from_wire(request.budget), strategy_from_wire("strategy", request.strategy)?);
    budget.visits(slots.count()).map_err(|error| PlanError::Day(error.into()))?;
    let selector = selector_from_wire("model", request.model)?;
    let certainty = certainty_from_wire("certainty", request.certainty)?;
    let weight = request.exploration_weight.unwrap_or(1.0);
    if !(0.0..=1.0).contains(&weight) {
        return Err(InvalidField::new("exploration_weight", format!("{weight} is not between 0 and 1")).into());
    }
    let middles: Vec<i64> = (0..slots.count()).map(|slot| slots.middle_nanos(slot)).collect();
    let tasks = request.task_states.iter().map(|name| find_state(&view, name)).collect::<Result<Vec<_>, _>>()?;
    for (i, &id) in tasks.iter().enumerate() {
        check_kind(&view, id, &format!("task_states[{i}]"))?;
    }
    let is_plain = request.model.is_none() && request.viewpoints.is_empty() && request.tour.is_none();
    if request.exactly_one && !(is_plain && request.task_states.is_empty()) {
        let text = "it is a model of locations: leave out model, viewpoints, tour and task_states";
        return Err(InvalidField::new("exactly_one", text).into());
    }
    let (names, information) = if let Some(tour) = &request.tour {
        if !(request.locations.is_empty() && request.viewpoints.is_empty()) {
            return Err(InvalidField::new("tour", "ask for tours, locations or viewpoints, not for several").into());
        }
        let tour = v1::PlanTourRequest { certainty: request.certainty, ..tour.clone() };
        (vec!["tour".to_owned()], tour_gains(explorations, &view, middles.clone(), &tour, selector).await?)
    } else if request.viewpoints.is_empty() {
        let (names, by_location) = locations(&view, request.locations, explorations.limits.predictions).await?;
        let counts: Vec<usize> = by_location.iter().map(Vec::len).collect();
        let rows = if request.exactly_one {
            let of = (names.as_slice(), by_location.as_slice());
            predict_presence(explorations, &handle, &view, of, (slot_nanos, middles.clone())).await?
        } else {
            let asked: Vec<StateOrCell> = by_location.into_iter().flatten().collect();
            predict_series(explorations.predict_context(), &handle, &view, (asked, middles.clone()), selector).await?
        };
        (names, gains(&rows, &counts, slots.count(), certainty).map_err(PlanError::from)?)
    } else {
        if !request.locations.is_empty() {
            return Err(InvalidField::new("locations", "ask for locations or for viewpoints, not for both").into());
        }
        let viewpoints: Vec<Viewpoint> = request.viewpoints.iter().map(viewpoint_from_wire).collect();
        let names = viewpoints.iter().map(|at| format!("{},{}", at.x_m, at.y_m)).collect();
        let scene = scene_from_wire(request.certainty, None)?;
        let looks = Looks { viewpoints, sensor: sensor_from_wire(request.sensor), scene, selector };
        (names, view_gains(explorations, &view, middles.clone(), looks).await?)
    };
    if weight < 1.0 && tasks.len() != names.len() {
        let text = format!("{} states for {} locations: name one per location", tasks.len(), names.len());
        return Err(InvalidField::new("task_states", text).into());
    }
    if weight >= 1.0 && !tasks.is_empty() {
        let text = "they are used only with an exploration_weight below 1";
        return Err(InvalidField::new("task_states", text).into());
    }
    let weighed = if weight < 1.0 {
        let of_tasks =
            predict_series(explorations.predict_context(), &handle, &view, (tasks, middles), selector).await?;
        let task = Gains::of(slots.count(), names.len(), |slot, place| of_tasks[place][slot]);
        let weighed = task.and_then(|task| information.weighed(&task, weight));
        Some(weighed.map_err(|error| PlanError::Day(error.into()))?)
    } else {
        None
    };
    let values = weighed.as_ref().unwrap_or(&information);
    let value = |nanos, place| slots.slot_at(nanos).map_or(0.0, |slot| values.at(slot, place));
    let mut rows = plan(&slots, names.len(), value, strategy, budget, request.seed).map_err(PlanError::from)?;
    for row in &mut rows {
        row.information_bits = row.location.map_or(0.0, |place| information.at(row.slot, place));
    }
    Ok(day_to_wire(&rows, &names))
}

/// The viewpoints, sensor, scene and model of the views.
struct Looks {
    viewpoints: Vec<Viewpoint>,
    sensor: Sensor,
    scene: SceneOptions,
    selector: ModelSelector,
}

/// The expected information of each viewpoint in each slot, times the probability of reaching it.
async fn view_gains(
    explorations: &Explorations,
    view: &Arc<MapView>,
    middles: Vec<i64>,
    looks: Looks,
) -> Result<Gains, RpcError> {
    check_for_cells("model", looks.selector)?;
    let cells = looks.viewpoints.len() as u64 * middles.len() as u64;
    check_limit("viewpoints x slots", cells, explorations.limits.predictions, "setting max_predictions")?;
    let options = PredictOptions { selector: looks.selector, ..explorations.predict_options() };
    let limits = explorations.look_limits();
    let view = Arc::clone(view);
    let work = move |stop: StopSignal<'_>| {
        let grid = PredictedTimes::new(&view, &middles, &options, stop)?;
        let scene = TimedScene::new(&grid, &looks.scene, stop)?;
        let reachability = view.site().reachability();
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(looks.viewpoints.len());
        view_many(&scene, &looks.sensor, &looks.viewpoints, limits, stop, |number, told| {
            let at = looks.viewpoints.get(number).copied().unwrap_or_default();
            let rate = reachability.rate(at.x_m, at.y_m).rate;
            let bits = told.unwrap_or_else(|_| vec![None; middles.len()]);
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
async fn tour_gains(
    explorations: &Explorations,
    view: &Arc<MapView>,
    middles: Vec<i64>,
    request: &v1::PlanTourRequest,
    selector: ModelSelector,
) -> Result<Gains, RpcError> {
    check_for_cells("model", selector)?;
    Explorations::check_grid_times(&middles)?;
    let (question, view) = (tour_question(view, request)?, Arc::clone(view));
    let options = PredictOptions { selector, ..explorations.predict_options() };
    let work = move |stop: StopSignal<'_>| {
        let tour = |&time_nanos: &i64| {
            let grid = PredictedGrid::new(&view, time_nanos, &options, stop)?;
            Ok::<_, PlanError>(plan_tour(&grid, view.site().reachability(), &question, stop)?)
        };
        let tours = middles.iter().map(tour).collect::<Result<Vec<Tour>, PlanError>>()?;
        if let Some(reason) = never_possible(&tours) {
            return Err(PlanError::NoTour(reason));
        }
        Gains::of(tours.len(), 1, |slot, _| tours[slot].expected_bits).map_err(|error| PlanError::Day(error.into()))
    };
    Ok(run_while_awaited(explorations.permits.take().await?, None, work).await??)
}

/// Why the robot cannot make a tour in any slot; `None` if it can, or if there is nothing to learn at some time.
fn never_possible(tours: &[Tour]) -> Option<NoTour> {
    let is_impossible = |tour: &Tour| tour.no_tour.is_some_and(|reason| reason != NoTour::NothingToLearn);
    tours.first().filter(|_| tours.iter().all(is_impossible))?.no_tour
}

/// The expected information of each location in each slot. `rows` has the states of the locations one after the other.
fn gains(
    rows: &[Vec<f64>],
    counts: &[usize],
    slots: usize,
    certainty: Certainty,
) -> Result<Gains, tidemap_plan::day::DayError> {
    let mut begin = 0;
    let of_location: Vec<&[Vec<f64>]> = counts
        .iter()
        .map(|count| {
            begin += count;
            &rows[begin - count..begin]
        })
        .collect();
    let gain = |slot: usize, place: usize| certainty.bits_of(of_location[place].iter().map(|row| row[slot]));
    Ok(Gains::of(slots, counts.len(), gain)?)
}
