//! Looks up what the names in a request refer to: maps, states and cells.
//!
//! Invariant: the error for an unknown name lists some known ones.

use std::{sync::Arc, time::Duration};

use tidemap_answer::{KnownCell, StateOrCell};
use tidemap_base::telemetry::traces::Span;
use tidemap_grid::{index::CellIndex, view::CellDescription};
use tidemap_ingest::{
    catalog::{Catalog, CatalogError},
    handle::{MapHandle, OpenProgress},
    protocol::EditSiteError,
};
use tidemap_map::{
    event::StateKind,
    ids::StateId,
    name::StateName,
    site::{InvalidEdit, Location},
    view::MapView,
};
use tidemap_proto::convert::{OverLimit, cells::cell_from_wire};

use super::status::{Misfit, Problem, RpcError};
use crate::guard::current_caller;

/// How long a request waits for a map that is being opened.
const OPEN_WITHIN: Duration = Duration::from_secs(10);

/// The map of this name, or an error that lists the existing ones. Waits until the map is open.
pub(super) async fn find_map(catalog: &Catalog, name: &str) -> Result<Arc<MapHandle>, RpcError> {
    let handle = find_published(catalog, name)?;
    match opened(&handle).await {
        Ok(()) => Ok(handle),
        // Meanwhile it may have failed to open.
        Err(error) => Err(find_published(catalog, name).err().unwrap_or(error)),
    }
}

/// Waits until a map is open.
pub(super) async fn opened(handle: &MapHandle) -> Result<(), RpcError> {
    match tokio::time::timeout(OPEN_WITHIN, handle.opened()).await {
        Ok(true) => Ok(()),
        Ok(false) => Err(RpcError::Stopping),
        Err(_) => {
            let (done, total) = match handle.opening() {
                OpenProgress::Open => return Ok(()),
                OpenProgress::Replay { done, total } => (done, total),
            };
            Err(RpcError::Opening { map: handle.spec.name.as_str().to_owned(), done, total })
        }
    }
}

/// Checks that the caller of this request may use a map of this name, whether there is one or not.
pub(super) fn check_scope(name: &str) -> Result<(), RpcError> {
    if current_caller().covers(name) {
        return Ok(());
    }
    metrics::counter!("tidemap_denied_total", "reason" => "NOT_FOR_MAP").increment(1);
    Err(RpcError::NotForMap { map: name.chars().take(80).collect() })
}

/// Checks that the caller of this request may send observations as this producer.
pub(super) fn check_producer(producer: &str) -> Result<(), RpcError> {
    if current_caller().may_send_as(producer) {
        return Ok(());
    }
    metrics::counter!("tidemap_denied_total", "reason" => "NOT_FOR_PRODUCER").increment(1);
    Err(RpcError::NotForProducer { producer: producer.chars().take(80).collect() })
}

/// Checks that the caller of this request may send observations of this map as this producer.
pub fn check_sender(map: &str, producer: &str) -> Result<(), RpcError> {
    check_scope(map)?;
    check_producer(producer)
}

/// The map of this name, even if it shows only the generation that the index publishes.
pub(super) fn find_published(catalog: &Catalog, name: &str) -> Result<Arc<MapHandle>, RpcError> {
    check_scope(name)?;
    let caller = current_caller();
    let found = catalog.get(name);
    if found.is_ok() {
        Span::current().text("tidemap.map", name);
    }
    found.map_err(|error| match error {
        CatalogError::Unknown(name) => {
            let all = catalog.all();
            let known = all.keys().map(|name| name.as_str()).filter(|name| caller.covers(name));
            let known = known.map(str::to_owned).collect();
            RpcError::UnknownMap { name, known }
        }
        error => error.into(),
    })
}

/// The state of this name, or an error that lists some existing ones, or the axes of a vector or an angle.
pub(super) fn find_state(view: &MapView, name: &str) -> Result<StateId, RpcError> {
    if let Some(id) = view.find(name) {
        return Ok(id);
    }
    let map = || view.spec().name.as_str().to_owned();
    if let Some((_, shape)) = view.shape(name).filter(|(_, shape)| shape.states() > 1) {
        let parts = view.labels(name).into_iter().map(|(_, label)| label).chain(shape.axes().iter().copied());
        let axes = parts.map(|part| format!("{name}/{part}")).collect();
        return Err(RpcError::IsVector { map: map(), name: name.to_owned(), shape, axes });
    }
    Err(RpcError::UnknownState {
        map: map(),
        name: name.chars().take(80).collect(),
        known: view.infos().take(11).map(|info| info.name.as_str().to_owned()).collect(),
    })
}

/// The state of this name, or all labels of a categorical state.
///
/// # Errors
/// See [`find_state`].
pub(super) fn find_parts(view: &MapView, name: &str) -> Result<Vec<StateId>, RpcError> {
    let labels: Vec<StateId> = view.labels(name).into_iter().map(|(id, _)| id).collect();
    if labels.is_empty() { Ok(vec![find_state(view, name)?]) } else { Ok(labels) }
}

/// The description of a cell.
pub(super) fn find_cell(view: &MapView, cell: CellIndex) -> Result<CellDescription, RpcError> {
    let map = || view.spec().name.as_str().to_owned();
    let grid = view.grid().ok_or_else(|| RpcError::NoGrid { map: map() })?;
    grid.describe(cell)?.ok_or_else(|| RpcError::UnknownCell { map: map(), name: cell.name() })
}

/// The states and cells of these names. `field` returns the field name of each.
///
/// # Errors
/// The error of the first name that is unknown.
pub(super) async fn find_all(
    view: &Arc<MapView>,
    field: impl Fn(usize) -> String + Send + 'static,
    names: Vec<String>,
) -> Result<Vec<StateOrCell>, RpcError> {
    let view = Arc::clone(view);
    let any_cell = names.iter().any(|name| matches!(CellIndex::from_name(name), Some(Ok(_))));
    let find = move || {
        let find = |(i, name): (usize, &String)| match cell_from_wire(&field(i), name)? {
            Some(cell) => find_known_cell(&view, cell).map(|cell| StateOrCell::Cell(Arc::new(cell))),
            None => find_state(&view, name).map(StateOrCell::State),
        };
        names.iter().enumerate().map(find).collect()
    };
    // A cell may have to be read from the disk.
    if any_cell { tidemap_base::task::blocking(find).await? } else { find() }
}

/// A cell with its tile and its description.
fn find_known_cell(view: &MapView, index: CellIndex) -> Result<KnownCell, RpcError> {
    let description = find_cell(view, index)?;
    let tile = view.grid().and_then(|grid| grid.find(index.tile().0));
    let unknown = || RpcError::UnknownCell { map: view.spec().name.as_str().to_owned(), name: index.name() };
    Ok(KnownCell { index, tile: tile.ok_or_else(unknown)?, description })
}

/// Checks an amount against its limit.
pub(super) fn check_limit(what: &'static str, got: u64, max: u64, setting: &'static str) -> Result<(), RpcError> {
    if got > max { Err(OverLimit { what, got: Some(got), max, setting }.into()) } else { Ok(()) }
}

/// Checks that a place of a map with a grid is within its extent or, without an extent, within the observed area. A
/// grid that has neither takes all places.
///
/// # Errors
/// The place is outside.
pub(super) fn check_on_grid(view: &MapView, field: &str, at_m: [f64; 2]) -> Result<(), Misfit> {
    let (Some(spec), Some(grid)) = (&view.spec().grid, view.grid()) else { return Ok(()) };
    let bounds = spec.extent.unwrap_or_else(|| grid.bounds());
    if bounds.count() == 0 {
        return Ok(());
    }
    let (low, high) = (spec.corner_m(bounds.min), spec.corner_m(bounds.max));
    if (low[0]..=high[0]).contains(&at_m[0]) && (low[1]..=high[1]).contains(&at_m[1]) {
        return Ok(());
    }
    let area = if spec.extent.is_some() { "the extent of the grid" } else { "the observed part of the grid" };
    let (low_m, high_m) = ([low[0], low[1]], [high[0], high[1]]);
    Err(Problem::Outside { at_m, area, low_m, high_m }.of(field))
}

/// Checks that a state is a probability, as entropies and plans need. `field` names the field of the request.
///
/// # Errors
/// The state has another kind.
pub(super) fn check_kind(view: &MapView, id: StateId, field: &str) -> Result<(), Misfit> {
    let kind = view.kind(id);
    if kind == StateKind::Probability {
        return Ok(());
    }
    let state = view.info(id).map_or_else(String::new, |info| info.name.as_str().to_owned());
    Err(Problem::NoProbability { state, kind }.of(field))
}

/// The states and cells of a location.
///
/// # Errors
/// The map has no such location.
pub(super) fn find_location<'a>(view: &'a MapView, name: &StateName) -> Result<&'a Location, RpcError> {
    let unknown = || EditSiteError::Invalid(InvalidEdit::UnknownLocation(name.as_str().to_owned()));
    view.site().locations().get(name).ok_or_else(|| RpcError::EditSite(unknown()))
}
