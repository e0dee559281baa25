//! Annotations of a map: its charger and its locations.
//!
//! Invariant: a change is durable when the call returns.

use tidemap_proto::{convert::site::point_to_wire, v1};

use crate::{connection::Client, error::Error};

/// States that are observed together, from one place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Location {
    /// Name of the location, 1 to 128 characters.
    pub name: String,
    /// Names of its states.
    pub states: Vec<String>,
    /// Position from which the robot observes them, x and y in metres.
    pub position_m: Option<[f64; 2]>,
}

pub(crate) fn point_from_wire(point: v1::Point) -> [f64; 2] {
    [point.x_m, point.y_m]
}

impl Location {
    fn from_wire(wire: v1::Location) -> Self {
        Self { name: wire.name, states: wire.states, position_m: wire.position.map(point_from_wire) }
    }
}

impl Client {
    /// Sets the position of the charger; `None` clears it.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn set_charger(&self, map: &str, at_m: Option<[f64; 2]>) -> Result<(), Error> {
        let request = v1::SetChargerRequest { map: map.to_owned(), charger: at_m.map(point_to_wire) };
        self.map_service().set_charger(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// Sets a location, or replaces the location with this name. Returns the location.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
    pub async fn set_location(&self, map: &str, location: Location) -> Result<Location, Error> {
        let Location { name, states, position_m } = location;
        let location = v1::Location { name, states, position: position_m.map(point_to_wire) };
        let request = v1::SetLocationRequest { map: map.to_owned(), location: Some(location) };
        let answer = self.map_service().set_location(request).await.map_err(|status| self.error(&status))?;
        answer.into_inner().location.map(Location::from_wire).ok_or(Error::Protocol("no location in the answer"))
    }

    /// Deletes a location; its states stay.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if no such name exists.
    pub async fn delete_location(&self, map: &str, location: &str) -> Result<(), Error> {
        let request = v1::DeleteLocationRequest { map: map.to_owned(), location: location.to_owned() };
        self.map_service().delete_location(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// All locations of a map, by name.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn locations(&self, map: &str) -> Result<Vec<Location>, Error> {
        let mut locations = Vec::new();
        let mut request = v1::ListLocationsRequest { map: map.to_owned(), page_size: 1000, ..Default::default() };
        loop {
            let answer = self.map_service().list_locations(request.clone()).await;
            let page = answer.map_err(|status| self.error(&status))?.into_inner();
            locations.extend(page.locations.into_iter().map(Location::from_wire));
            if page.next_page_token.is_empty() {
                return Ok(locations);
            }
            request.page_token = page.next_page_token;
        }
    }
}
