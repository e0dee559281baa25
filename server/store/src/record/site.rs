//! A site and its edits as messages, and back.
//!
//! Invariant: decoding gives the encoded value, bit by bit.

use tidemap_grid::index::CellIndex;
use tidemap_map::{
    ids::StateId,
    name::StateName,
    no_go::NoGoEdit,
    reachability::{Attempts, Reachability, ReachabilityCell},
    site::{Location, Site, SiteEdit},
    traversal::Failures,
};
use tidemap_migrations::v1::site as v1;

use super::{Invalid, ids::decode_state_name, landmark, task, topology, traversal};

fn encode_place(at: [f64; 2]) -> v1::Place {
    let [x_bits, y_bits] = at.map(f64::to_bits);
    v1::Place { x_bits, y_bits }
}

fn decode_place(place: &v1::Place) -> [f64; 2] {
    [place.x_bits, place.y_bits].map(f64::from_bits)
}

fn encode_location(name: &StateName, location: &Location) -> v1::Location {
    v1::Location {
        name: name.as_str().to_owned(),
        states: location.states.iter().map(|state| state.0).collect(),
        place: location.position_m.map(encode_place),
        cells: location.cells.iter().map(|&CellIndex { x, y, z }| v1::SiteCell { x, y, z }).collect(),
    }
}

fn decode_location(message: &v1::Location) -> Result<(StateName, Location), Invalid> {
    let states = message.states.iter().map(|&id| StateId(id)).collect();
    let position_m = message.place.as_ref().map(decode_place);
    let cells = message.cells.iter().map(|&v1::SiteCell { x, y, z }| CellIndex { x, y, z }).collect();
    Ok((decode_state_name(&message.name)?, Location { states, cells, position_m }))
}

fn encode_area(name: &StateName, corners: &[[f64; 2]]) -> v1::NoGoArea {
    v1::NoGoArea { name: name.as_str().to_owned(), corners: corners.iter().map(|at| encode_place(*at)).collect() }
}

fn decode_area(message: &v1::NoGoArea) -> Result<(StateName, Vec<[f64; 2]>), Invalid> {
    Ok((decode_state_name(&message.name)?, message.corners.iter().map(decode_place).collect()))
}

fn encode_attempts((cell, attempts): (ReachabilityCell, Attempts)) -> v1::Attempts {
    let Attempts { count, reached, last_nanos } = attempts;
    v1::Attempts { x: cell.x, y: cell.y, count: count.into(), reached: reached.into(), last_nanos }
}

fn decode_attempts(message: &v1::Attempts) -> Result<(ReachabilityCell, Attempts), Invalid> {
    const MANY: Invalid = "a place has more attempts than count";
    let count = u8::try_from(message.count).map_err(|_| MANY)?;
    let reached = u8::try_from(message.reached).map_err(|_| MANY)?;
    let cell = ReachabilityCell { x: message.x, y: message.y };
    Ok((cell, Attempts { count, reached, last_nanos: message.last_nanos }))
}

/// A site without its landmarks; `None` for an empty one.
pub(crate) fn encode(site: &Site) -> Option<v1::Site> {
    (!site.is_empty()).then(|| v1::Site {
        charger: site.charger_m().map(encode_place),
        locations: site.locations().iter().map(|(name, location)| encode_location(name, location)).collect(),
        attempts: site.reachability().parts().map(encode_attempts).collect(),
        topology: topology::encode(site.topology()),
        failures: site.failures().oldest_first().map(traversal::encode_failure).collect(),
        tasks: task::encode_book(site.tasks()),
        no_go: site.no_go().iter().map(|(name, corners)| encode_area(name, corners)).collect(),
    })
}

/// The site of a map with `states` states.
pub(crate) fn decode(message: &v1::Site, states: usize) -> Result<Site, String> {
    let mut site = Site::default();
    let mut apply = |edit| site.apply(&edit, states).map_err(|error| error.to_string());
    if let Some(place) = &message.charger {
        apply(SiteEdit::Charger(Some(decode_place(place))))?;
    }
    for location in &message.locations {
        let (name, location) = decode_location(location)?;
        apply(SiteEdit::SetLocation(name, location))?;
    }
    for area in &message.no_go {
        let (name, corners) = decode_area(area)?;
        apply(SiteEdit::NoGo(NoGoEdit::Set(name, corners)))?;
    }
    let attempts = message.attempts.iter().map(decode_attempts).collect::<Result<Vec<_>, Invalid>>()?;
    let reachability = Reachability::default().with_parts(attempts).map_err(|error| error.to_string())?;
    let mut failures = Failures::default();
    for failure in &message.failures {
        failures.add(traversal::decode_failure(failure)?);
    }
    let tasks = message.tasks.as_ref().map(task::decode_book).transpose()?.unwrap_or_default();
    let site = site.with_reachability(reachability).with_failures(failures).with_tasks(tasks);
    Ok(match &message.topology {
        Some(message) => site.with_topology(topology::decode(message)?),
        None => site,
    })
}

pub(super) fn encode_edit(edit: &SiteEdit) -> v1::SiteEdit {
    let change = match edit {
        SiteEdit::Charger(Some(at)) => v1::Change::Charger(encode_place(*at)),
        SiteEdit::Charger(None) => v1::Change::NoCharger(true),
        SiteEdit::SetLocation(name, location) => v1::Change::SetLocation(encode_location(name, location)),
        SiteEdit::RemoveLocation(name) => v1::Change::RemoveLocation(name.as_str().to_owned()),
        SiteEdit::Visit { at_m, reached, utc_nanos } => {
            v1::Change::Visit(v1::Visit { place: Some(encode_place(*at_m)), reached: *reached, utc_nanos: *utc_nanos })
        }
        SiteEdit::Topology(edit) => v1::Change::Topology(topology::encode_edit(edit)),
        SiteEdit::Landmarks(edit) => v1::Change::Landmarks(landmark::encode_edit(edit)),
        SiteEdit::Task(edit) => v1::Change::Task(task::encode_edit(edit)),
        SiteEdit::NoGo(NoGoEdit::Set(name, corners)) => v1::Change::SetNoGo(encode_area(name, corners)),
        SiteEdit::NoGo(NoGoEdit::Remove(name)) => v1::Change::RemoveNoGo(name.as_str().to_owned()),
    };
    v1::SiteEdit { change: Some(change) }
}

pub(super) fn decode_edit(message: &v1::SiteEdit) -> Result<SiteEdit, Invalid> {
    Ok(match message.change.as_ref().ok_or("an edit of the site changes nothing")? {
        v1::Change::Charger(place) => SiteEdit::Charger(Some(decode_place(place))),
        v1::Change::NoCharger(_) => SiteEdit::Charger(None),
        v1::Change::SetLocation(location) => {
            let (name, location) = decode_location(location)?;
            SiteEdit::SetLocation(name, location)
        }
        v1::Change::RemoveLocation(name) => SiteEdit::RemoveLocation(decode_state_name(name)?),
        v1::Change::Visit(v1::Visit { place, reached, utc_nanos }) => {
            let place = place.as_ref().ok_or("a visit has no place")?;
            SiteEdit::Visit { at_m: decode_place(place), reached: *reached, utc_nanos: *utc_nanos }
        }
        v1::Change::Topology(edit) => SiteEdit::Topology(topology::decode_edit(edit)?),
        v1::Change::Landmarks(edit) => SiteEdit::Landmarks(landmark::decode_edit(edit)?),
        v1::Change::Task(edit) => SiteEdit::Task(task::decode_edit(edit)?),
        v1::Change::SetNoGo(area) => {
            let (name, corners) = decode_area(area)?;
            SiteEdit::NoGo(NoGoEdit::Set(name, corners))
        }
        v1::Change::RemoveNoGo(name) => SiteEdit::NoGo(NoGoEdit::Remove(decode_state_name(name)?)),
    })
}
