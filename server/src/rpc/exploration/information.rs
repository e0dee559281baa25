//! `GetInformation`: the entropy of states, locations and regions, and the expected information of an observation.
//!
//! Invariant: replies come in the order of states, locations, region; each has a number per time.

use std::sync::Arc;

use tidemap_map::{
    name::StateName,
    site::{InvalidEdit, Location},
    view::MapView,
};
use tidemap_model::StopSignal;
use tidemap_plan::{
    information::{Certainty, entropy_of},
    predicted::{PredictOptions, PredictedTimes},
};
use tidemap_proto::{
    convert::{
        InvalidField,
        exploration::{certainty_from_wire, times_from_wire},
        grid::cell_box_from_wire,
        query::{check_for_cells, selector_from_wire},
    },
    v1,
};

use super::Explorations;
use crate::{
    ingest::protocol::EditSiteError,
    rpc::{
        lookup::{check_limit, find_all, find_map},
        replies::{Replies, compute_replies, stream_replies},
        series::{check_kind, predict_series},
        status::{PlanError, RpcError},
    },
    state_or_cell::StateOrCell,
};

/// Maximum number of targets of one request.
const TARGETS_MAX: usize = 10_000;

/// The states and cells of locations, each as named in the field `locations`. `max`: how many all may have together.
///
/// # Errors
/// An unknown location, a state that is no probability, or too many.
pub(super) async fn members(
    view: &Arc<MapView>,
    names: &[String],
    max: u64,
) -> Result<Vec<Vec<StateOrCell>>, RpcError> {
    let mut asked = Vec::with_capacity(names.len());
    let mut total = 0;
    for (i, name) in names.iter().enumerate() {
        let field = format!("locations[{i}]");
        let unknown = || RpcError::EditSite(EditSiteError::Invalid(InvalidEdit::UnknownLocation(name.to_owned())));
        let known = StateName::new(name).map_err(|error| InvalidField::new(&field, error))?;
        let location = view.site().locations().get(&known).ok_or_else(unknown)?;
        location.states.iter().try_for_each(|&id| check_kind(view, id, &field))?;
        total += (location.states.len() + location.cells.len()) as u64;
        // Each cell will have its description in memory.
        check_limit("predictions", total, max, "setting max_predictions")?;
        asked.push(location);
    }
    let cells = asked.iter().flat_map(|location| &location.cells).map(|cell| cell.name()).collect();
    let mut cells = find_all(view, |_| "locations".to_owned(), cells).await?.into_iter();
    let of = |location: &Location| {
        let states = location.states.iter().map(|&id| StateOrCell::State(id));
        states.chain(cells.by_ref().take(location.cells.len())).collect()
    };
    Ok(asked.into_iter().map(of).collect())
}

fn reply(target: &str, rows: &[Vec<f64>], times: usize, certainty: Certainty) -> v1::GetInformationResponse {
    let at = |time: usize| rows.iter().map(move |row| row[time]);
    v1::GetInformationResponse {
        target: target.to_owned(),
        entropy_bits: (0..times).map(|time| entropy_of(at(time))).collect(),
        information_bits: (0..times).map(|time| certainty.bits_of(at(time))).collect(),
        states: rows.len() as u64,
    }
}

/// The information of all observed cells of a region.
fn of_region(
    view: &MapView,
    times_nanos: &[i64],
    options: &PredictOptions,
    (certainty, most): (Certainty, u64),
    stop: StopSignal<'_>,
) -> Result<v1::GetInformationResponse, RpcError> {
    let grid = PredictedTimes::new(view, times_nanos, options, stop).map_err(PlanError::from)?;
    let cells = grid.lattice().size().iter().map(|&along| along as u64).product::<u64>();
    check_limit("cells x times", cells * times_nanos.len() as u64, most, "setting max_predictions")?;
    let mut reply = v1::GetInformationResponse { target: "region".to_owned(), ..Default::default() };
    for time in 0..grid.times() {
        stop.check()?;
        let Some(grid) = grid.at(time) else { break };
        let known = || grid.known().map(f64::from);
        reply.states = known().count() as u64;
        reply.entropy_bits.push(entropy_of(known()));
        reply.information_bits.push(certainty.bits_of(known()));
    }
    Ok(reply)
}

pub(super) async fn get_information(
    explorations: &Explorations,
    request: v1::GetInformationRequest,
) -> Result<Replies<v1::GetInformationResponse>, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let view = handle.view();
    let v1::GetInformationRequest { times_nanos, states, locations, region, model, certainty, .. } = request;
    times_from_wire("times_nanos", &times_nanos)?;
    let selector = selector_from_wire("model", model)?;
    let certainty = certainty_from_wire("certainty", certainty)?;
    if states.is_empty() && locations.is_empty() && region.is_none() {
        return Err(InvalidField::new("states", "name a state, a location or a region").into());
    }
    check_limit("targets", (states.len() + locations.len()) as u64, TARGETS_MAX as u64, "one request")?;
    if let Some(region) = region {
        check_for_cells("model", selector)?;
        view.grid().ok_or(PlanError::from(tidemap_plan::predicted::PredictError::NoGrid))?;
        if !states.is_empty() || !locations.is_empty() {
            return Err(InvalidField::new("region", "ask for a region in a request of its own").into());
        }
        Explorations::check_grid_times(&times_nanos)?;
        let options =
            PredictOptions { selector, region: Some(cell_box_from_wire(&region)), ..explorations.predict_options() };
        let most = explorations.limits.predictions;
        let permit = explorations.permits.take().await?;
        return Ok(compute_replies(vec![permit], move |sink| {
            let is_left = || sink.is_closed();
            let stop = StopSignal::new(&is_left);
            sink.send(of_region(&view, &times_nanos, &options, (certainty, most), stop)?);
            Ok(())
        }));
    }
    let found = find_all(&view, |i| format!("states[{i}]"), states.clone()).await?;
    let mut targets: Vec<(String, Vec<StateOrCell>)> = Vec::with_capacity(states.len() + locations.len());
    for (i, (name, state)) in states.into_iter().zip(found).enumerate() {
        if let StateOrCell::State(id) = state {
            check_kind(&view, id, &format!("states[{i}]"))?;
        }
        targets.push((name, vec![state]));
    }
    let of_locations = members(&view, &locations, explorations.limits.predictions).await?;
    targets.extend(locations.into_iter().zip(of_locations));
    let predictions = targets.iter().map(|(_, states)| states.len() as u64).sum::<u64>() * times_nanos.len() as u64;
    check_limit("predictions", predictions, explorations.limits.predictions, "setting max_predictions")?;
    let asked = explorations.clone();
    Ok(stream_replies(move |sink| async move {
        for (name, states) in targets {
            let rows = tokio::select! {
                () = sink.closed() => return Ok(()),
                rows = predict_series(asked.predict_context(), &handle, &view, (states, times_nanos.clone()), selector) => rows?,
            };
            let answer = reply(&name, &rows, times_nanos.len(), certainty);
            let to = sink.clone();
            if !tokio::task::spawn_blocking(move || to.send(answer)).await.map_err(|_| RpcError::Stopping)? {
                break;
            }
        }
        Ok(())
    }))
}
