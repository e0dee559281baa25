//! The attempts of robots to reach places, on the disk: one row, with the cells in which robots tried to reach a place.
//!
//! Invariant: written data is read back bit by bit.

use tidemap_layout::site as layout;
use tidemap_map::{
    reachability::{Attempts, Reachability, ReachabilityCell},
    site::{Site, SiteEdit},
};

use super::{StoredTable, decode_position, encode_position};
use crate::record::Invalid;

pub(super) enum ReachedCells {}

fn encode((cell, attempts): (ReachabilityCell, Attempts)) -> layout::Attempts {
    let Attempts { count, reached, last_nanos } = attempts;
    layout::Attempts { x: cell.x, y: cell.y, count: count.into(), reached: reached.into(), last_nanos }
}

fn decode(message: &layout::Attempts) -> Result<(ReachabilityCell, Attempts), Invalid> {
    const MANY: Invalid = "a place has more attempts than count";
    let count = u8::try_from(message.count).map_err(|_| MANY)?;
    let reached = u8::try_from(message.reached).map_err(|_| MANY)?;
    let cell = ReachabilityCell { x: message.x, y: message.y };
    Ok((cell, Attempts { count, reached, last_nanos: message.last_nanos }))
}

impl StoredTable for ReachedCells {
    const NUMBER: u32 = 4;
    type Row = layout::Reachability;
    type Edit = layout::Visit;

    fn count(site: &Site) -> usize {
        usize::from(site.reachability().parts().next().is_some())
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::Reachability> {
        let cells: Vec<_> = site.reachability().parts().map(encode).collect();
        (!cells.is_empty()).then_some(layout::Reachability { cells }).into_iter()
    }

    fn restore(site: Site, rows: Vec<layout::Reachability>, _: usize) -> Result<Site, String> {
        let cells = rows.iter().flat_map(|row| &row.cells).map(decode).collect::<Result<Vec<_>, Invalid>>()?;
        let reachability = Reachability::default().with_parts(cells).map_err(|error| error.to_string())?;
        Ok(site.with_reachability(reachability))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::Visit> {
        let SiteEdit::Visit { at_m, reached, utc_nanos } = edit else { return None };
        Some(layout::Visit { position: Some(encode_position(*at_m)), reached: *reached, utc_nanos: *utc_nanos })
    }

    fn decode_edit(visit: layout::Visit) -> Result<SiteEdit, Invalid> {
        let position = visit.position.as_ref().ok_or("a visit has no position")?;
        Ok(SiteEdit::Visit { at_m: decode_position(position), reached: visit.reached, utc_nanos: visit.utc_nanos })
    }
}
