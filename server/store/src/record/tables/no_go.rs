//! The no-go areas on the disk: a row for each area, ascending by name.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_layout::site as layout;
use tidemap_map::{
    name::StateName,
    no_go::NoGoEdit,
    site::{Site, SiteEdit},
};

use super::{StoredTable, decode_position, encode_position, restored};
use crate::record::{Invalid, ids::decode_state_name};

pub(super) enum NoGo {}

fn encode(name: &StateName, corners: &[[f64; 2]]) -> layout::NoGoArea {
    layout::NoGoArea {
        name: name.as_str().to_owned(),
        corners: corners.iter().map(|at| encode_position(*at)).collect(),
    }
}

fn decode(message: &layout::NoGoArea) -> Result<SiteEdit, Invalid> {
    let corners = message.corners.iter().map(decode_position).collect();
    Ok(SiteEdit::NoGo(NoGoEdit::Set(decode_state_name(&message.name)?, corners)))
}

impl StoredTable for NoGo {
    const NUMBER: u32 = 3;
    type Row = layout::NoGoArea;
    type Edit = layout::NoGoEdit;

    fn count(site: &Site) -> usize {
        site.no_go().iter().count()
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::NoGoArea> {
        site.no_go().iter().map(|(name, corners)| encode(name, corners))
    }

    fn restore(site: Site, rows: Vec<layout::NoGoArea>, states: usize) -> Result<Site, String> {
        rows.iter().try_fold(site, |site, row| restored(site, &decode(row)?, states))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::NoGoEdit> {
        let SiteEdit::NoGo(edit) = edit else { return None };
        let change = match edit {
            NoGoEdit::Set(name, corners) => layout::NoGoChange::Set(encode(name, corners)),
            NoGoEdit::Remove(name) => layout::NoGoChange::Remove(name.as_str().to_owned()),
        };
        Some(layout::NoGoEdit { change: Some(change) })
    }

    fn decode_edit(edit: layout::NoGoEdit) -> Result<SiteEdit, Invalid> {
        match edit.change.ok_or("an edit of the no-go areas changes nothing")? {
            layout::NoGoChange::Set(area) => decode(&area),
            layout::NoGoChange::Remove(name) => Ok(SiteEdit::NoGo(NoGoEdit::Remove(decode_state_name(&name)?))),
        }
    }
}
