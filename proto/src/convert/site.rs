//! Annotations of a map: its charger and its locations.

use tidemap_map::{
    name::StateName,
    site::{Location, PLACE_MAX_M},
    view::MapView,
};

use super::InvalidField;
use crate::v1;

/// A point from the wire: x, y in metres.
///
/// # Errors
/// A coordinate is not a number, or out of range.
pub fn point_from_wire(field: &str, point: v1::Point) -> Result<[f64; 2], InvalidField> {
    let v1::Point { x_m, y_m } = point;
    for (axis, along) in [("x_m", x_m), ("y_m", y_m)] {
        if !(-PLACE_MAX_M..=PLACE_MAX_M).contains(&along) {
            let text = format!("{along} is not a number of metres between -1e7 and 1e7");
            return Err(InvalidField::new(format!("{field}.{axis}"), text));
        }
    }
    Ok([x_m, y_m])
}

/// The name of a location.
///
/// # Errors
/// It is not a valid name.
pub fn location_name_from_wire(field: &str, name: &str) -> Result<StateName, InvalidField> {
    StateName::new(name).map_err(|error| InvalidField::new(field, error))
}

/// The names of locations, each named by its place in the field.
///
/// # Errors
/// One is not a valid name.
pub fn location_names_from_wire(field: &str, names: &[String]) -> Result<Vec<StateName>, InvalidField> {
    let name = |(i, name): (usize, &String)| location_name_from_wire(&format!("{field}[{i}]"), name);
    names.iter().enumerate().map(name).collect()
}

/// A location, with the names of its members.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedLocation {
    /// Name of the location.
    pub name: StateName,
    /// Names of its states and cells.
    pub members: Vec<String>,
    /// Position of the location: x, y in metres.
    pub position_m: Option<[f64; 2]>,
}

/// A location with the names of its members.
///
/// # Errors
/// The invalid field; whether its members exist is not checked.
pub fn location_from_wire(location: Option<v1::Location>) -> Result<NamedLocation, InvalidField> {
    let v1::Location { name, states, position } = location.unwrap_or_default();
    let name = location_name_from_wire("location.name", &name)?;
    let position_m = position.map(|at| point_from_wire("location.position", at)).transpose()?;
    Ok(NamedLocation { name, members: states, position_m })
}

/// A point for the wire.
#[must_use]
pub fn point_to_wire([x_m, y_m]: [f64; 2]) -> v1::Point {
    v1::Point { x_m, y_m }
}

/// A location with the names of its members, for the wire.
#[must_use]
pub fn named_location_to_wire(location: NamedLocation) -> v1::Location {
    let NamedLocation { name, members, position_m } = location;
    v1::Location { name: name.as_str().to_owned(), states: members, position: position_m.map(point_to_wire) }
}

/// A location for the wire.
#[must_use]
pub fn location_to_wire(view: &MapView, name: &StateName, location: &Location) -> v1::Location {
    let name_of = |id| view.info(id).map(|info| info.name.as_str().to_owned());
    v1::Location {
        name: name.as_str().to_owned(),
        states: location
            .states
            .iter()
            .filter_map(|&id| name_of(id))
            .chain(location.cells.iter().map(|cell| cell.name()))
            .collect(),
        position: location.position_m.map(point_to_wire),
    }
}

/// An area that nothing is planned through, with its corners in metres.
///
/// # Errors
/// The invalid field; the number of corners is not checked.
pub fn area_from_wire(area: Option<v1::NoGoArea>) -> Result<(StateName, Vec<[f64; 2]>), InvalidField> {
    let v1::NoGoArea { name, corners } = area.unwrap_or_default();
    let name = location_name_from_wire("area.name", &name)?;
    let corner = |(i, at): (usize, v1::Point)| point_from_wire(&format!("area.corners[{i}]"), at);
    Ok((name, corners.into_iter().enumerate().map(corner).collect::<Result<_, _>>()?))
}

/// An area for the wire.
#[must_use]
pub fn area_to_wire(name: &StateName, corners: &[[f64; 2]]) -> v1::NoGoArea {
    v1::NoGoArea { name: name.to_string(), corners: corners.iter().map(|at| point_to_wire(*at)).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_name_the_coordinate_that_is_wrong() {
        let point = |x_m, y_m| point_from_wire("start", v1::Point { x_m, y_m });
        assert_eq!(point(1.0, -2.5), Ok([1.0, -2.5]));
        assert_eq!(point(f64::NAN, 0.0).expect_err("wrong").field, "start.x_m");
        assert_eq!(point(0.0, 2e7).expect_err("wrong").field, "start.y_m");
    }
}
