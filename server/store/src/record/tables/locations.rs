//! The locations on the disk: a row for each location, ascending by name.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_grid::index::CellIndex;
use tidemap_layout::site as layout;
use tidemap_map::{
    ids::StateId,
    name::StateName,
    site::{Location, Site, SiteEdit},
};

use super::{StoredTable, decode_position, encode_position, restored};
use crate::record::{Invalid, ids::decode_state_name};

pub(super) enum Locations {}

fn encode(name: &StateName, location: &Location) -> layout::Location {
    layout::Location {
        name: name.as_str().to_owned(),
        states: location.states.iter().map(|state| state.0).collect(),
        position: location.position_m.map(encode_position),
        cells: location.cells.iter().map(|&CellIndex { x, y, z }| layout::SiteCell { x, y, z }).collect(),
    }
}

fn decode(message: &layout::Location) -> Result<SiteEdit, Invalid> {
    let states = message.states.iter().map(|&id| StateId(id)).collect();
    let position_m = message.position.as_ref().map(decode_position);
    let cells = message.cells.iter().map(|&layout::SiteCell { x, y, z }| CellIndex { x, y, z }).collect();
    Ok(SiteEdit::SetLocation(decode_state_name(&message.name)?, Location { states, cells, position_m }))
}

impl StoredTable for Locations {
    const NUMBER: u32 = 2;
    type Row = layout::Location;
    type Edit = layout::LocationEdit;

    fn count(site: &Site) -> usize {
        site.locations().len()
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::Location> {
        site.locations().iter().map(|(name, location)| encode(name, location))
    }

    fn restore(site: Site, rows: Vec<layout::Location>, states: usize) -> Result<Site, String> {
        rows.iter().try_fold(site, |site, row| restored(site, &decode(row)?, states))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::LocationEdit> {
        let change = match edit {
            SiteEdit::SetLocation(name, location) => layout::LocationChange::Set(encode(name, location)),
            SiteEdit::RemoveLocation(name) => layout::LocationChange::Remove(name.as_str().to_owned()),
            _ => return None,
        };
        Some(layout::LocationEdit { change: Some(change) })
    }

    fn decode_edit(edit: layout::LocationEdit) -> Result<SiteEdit, Invalid> {
        match edit.change.ok_or("an edit of the locations changes nothing")? {
            layout::LocationChange::Set(location) => decode(&location),
            layout::LocationChange::Remove(name) => Ok(SiteEdit::RemoveLocation(decode_state_name(&name)?)),
        }
    }
}
