//! The charger on the disk: one row, if the charger is set.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_layout::site as layout;
use tidemap_map::site::{Site, SiteEdit};

use super::{StoredTable, decode_position, encode_position, restored};
use crate::record::Invalid;

pub(super) enum Charger {}

impl StoredTable for Charger {
    const NUMBER: u32 = 1;
    type Row = layout::Position;
    type Edit = layout::ChargerEdit;

    fn count(site: &Site) -> usize {
        usize::from(site.charger_m().is_some())
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::Position> {
        site.charger_m().map(encode_position).into_iter()
    }

    fn restore(site: Site, rows: Vec<layout::Position>, states: usize) -> Result<Site, String> {
        let [position] = rows.as_slice() else { return Err("a map has one charger at most".to_owned()) };
        restored(site, &SiteEdit::Charger(Some(decode_position(position))), states)
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::ChargerEdit> {
        let SiteEdit::Charger(position) = edit else { return None };
        Some(layout::ChargerEdit { position: position.map(encode_position) })
    }

    fn decode_edit(edit: layout::ChargerEdit) -> Result<SiteEdit, Invalid> {
        Ok(SiteEdit::Charger(edit.position.as_ref().map(decode_position)))
    }
}
