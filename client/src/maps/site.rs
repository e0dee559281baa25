//! Annotations of a map: its charger and its locations.
//!
//! Invariant: a change is durable when the call returns.

use tidemap_proto::{
    convert::site::{NamedLocation, location_from_wire, named_location_to_wire, point_to_wire},
    v1,
};

use crate::{connection::Client, error::Error};

pub(super) fn point_from_wire(point: v1::Point) -> [f64; 2] {
    [point.x_m, point.y_m]
}

fn replied(location: Option<v1::Location>) -> Result<NamedLocation, Error> {
    location_from_wire(location).map_err(|_| Error::Protocol("no valid location in the answer"))
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
    pub async fn set_location(&self, map: &str, location: NamedLocation) -> Result<NamedLocation, Error> {
        let location = Some(named_location_to_wire(location));
        let request = v1::SetLocationRequest { map: map.to_owned(), location };
        let answer = self.map_service().set_location(request).await.map_err(|status| self.error(&status))?;
        replied(answer.into_inner().location)
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
    pub async fn locations(&self, map: &str) -> Result<Vec<NamedLocation>, Error> {
        let mut locations = Vec::new();
        let mut request = v1::ListLocationsRequest { map: map.to_owned(), page_size: 1000, ..Default::default() };
        loop {
            let answer = self.map_service().list_locations(request.clone()).await;
            let page = answer.map_err(|status| self.error(&status))?.into_inner();
            for location in page.locations {
                locations.push(replied(Some(location))?);
            }
            if page.next_page_token.is_empty() {
                return Ok(locations);
            }
            request.page_token = page.next_page_token;
        }
    }
}
