//! Locations to explore, with their states and cells.
//!
//! Invariant: every state of a location is a probability, and every location has a name.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_map::{
    event::StateKind,
    name::StateName,
    site::Location,
    view::{MapView, StateInfo},
};

use crate::{
    lookup::{check_kind, check_limit, find_all, find_location, find_state},
    status::{Problem, RpcError},
};

/// Maximum number of locations of one request.
const LOCATIONS_MAX: usize = 10_000;

/// Locations by name, with their states and cells; at least one.
pub(super) struct Locations {
    pub names: Vec<String>,
    pub members: Vec<Vec<StateOrCell>>,
}

/// The locations to choose from, with at most `max` states and cells. If the request names none, they are the locations
/// of the map; if the map has none, every probability is a location.
///
/// # Errors
/// An unknown location, a state that is no probability, too many, or nothing to explore.
pub(super) async fn find_locations(
    view: &Arc<MapView>,
    requested: &[StateName],
    max: u64,
) -> Result<Locations, RpcError> {
    let known: Vec<StateName>;
    let requested = if requested.is_empty() {
        known = view.site().locations().keys().cloned().collect();
        &known
    } else {
        requested
    };
    check_limit("locations", requested.len() as u64, LOCATIONS_MAX as u64, "one request")?;
    if !requested.is_empty() {
        let members = find_members(view, requested, max).await?;
        return Ok(Locations { names: requested.iter().map(|name| name.as_str().to_owned()).collect(), members });
    }
    let is_probability = |info: &&StateInfo| info.kind == StateKind::Probability;
    let names: Vec<String> = view.infos().filter(is_probability).map(|info| info.name.as_str().to_owned()).collect();
    check_limit("states", names.len() as u64, LOCATIONS_MAX as u64, "one request without locations")?;
    if names.is_empty() {
        return Err(Problem::NothingToExplore.of("locations").into());
    }
    let members = names.iter().map(|name| find_state(view, name).map(|id| vec![id.into()]));
    let members = members.collect::<Result<_, _>>()?;
    Ok(Locations { names, members })
}

/// The states and cells of locations, each as named in the field `locations`. `max` is the limit for all together.
///
/// # Errors
/// An unknown location, a state that is no probability, or too many.
pub(super) async fn find_members(
    view: &Arc<MapView>,
    names: &[StateName],
    max: u64,
) -> Result<Vec<Vec<StateOrCell>>, RpcError> {
    let mut requested = Vec::with_capacity(names.len());
    let mut total = 0;
    for (i, name) in names.iter().enumerate() {
        let location = find_location(view, name)?;
        let field = format!("locations[{i}]");
        location.states.iter().try_for_each(|&id| check_kind(view, id, &field))?;
        total += (location.states.len() + location.cells.len()) as u64;
        // Each cell will have its description in memory.
        check_limit("predictions", total, max, "setting max_predictions")?;
        requested.push(location);
    }
    let cells = requested.iter().flat_map(|location| &location.cells).map(|cell| cell.name()).collect();
    let mut cells = find_all(view, |_| "locations".to_owned(), cells).await?.into_iter();
    let members = |location: &Location| {
        let states = location.states.iter().map(|&id| StateOrCell::State(id));
        states.chain(cells.by_ref().take(location.cells.len())).collect()
    };
    Ok(requested.into_iter().map(members).collect())
}
