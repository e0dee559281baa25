//! `ListCellAlarms`: the cells of a grid whose change alarm rings.
//!
//! Invariant: the whole answer is from one view, and each such cell of the region is listed once.

use std::sync::Arc;

use tidemap_grid::predict::GridQuestion;
use tidemap_proto::{
    convert::{cells::cell_alarm_to_wire, grid::cell_box_from_wire},
    v1,
};

use super::Queries;
use crate::{
    lookup::{check_limit, find_map},
    replies::{Replies, compute_replies},
    status::RpcError,
};

/// Number of cells in one reply.
const CELLS_PER_REPLY: usize = 1024;

pub(super) async fn list_cell_alarms(
    queries: &Queries,
    request: v1::ListCellAlarmsRequest,
) -> Result<Replies<v1::ListCellAlarmsResponse>, RpcError> {
    let view = find_map(&queries.catalog, &request.map).await?.view();
    let region = request.region.as_ref().map(cell_box_from_wire);
    let no_grid = || RpcError::NoGrid { map: view.spec().name.as_str().to_owned() };
    view.grid().ok_or_else(no_grid)?;
    let permit = queries.permits.take().await?;
    // This reads every tile of the map at most, in some milliseconds.
    let question = GridQuestion { region, ..GridQuestion::default() };
    let for_selection = Arc::clone(&view);
    let select = move || (permit, for_selection.grid().map(|grid| grid.select(&question)));
    let (permit, selection) = tidemap_base::task::blocking(select).await?;
    let selection = selection.ok_or_else(no_grid)?;
    check_limit("cells to examine", selection.cells, queries.max_predictions, "setting max_predictions")?;
    drop(permit);
    let permit = queries.permit_for(selection.cells).await?;
    Ok(compute_replies(vec![permit], move |sink| {
        let Some(grid) = view.grid() else { return Ok(()) };
        let mut cells = Vec::new();
        for &tile in &selection.tiles {
            if sink.is_closed() {
                return Ok(());
            }
            let found = grid.cell_alarms(tile, &selection.region)?;
            cells.extend(found.iter().map(|(cell, description)| cell_alarm_to_wire(*cell, description)));
            if cells.len() >= CELLS_PER_REPLY {
                let full = std::mem::take(&mut cells);
                if !sink.send(v1::ListCellAlarmsResponse { cells: full }) {
                    return Ok(());
                }
            }
        }
        if !cells.is_empty() {
            sink.send(v1::ListCellAlarmsResponse { cells });
        }
        Ok(())
    }))
}
