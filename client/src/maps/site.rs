//! Annotations of a map: its charger and its locations.
//!
//! Invariant: a change is durable when the call returns.

use tidemap_proto::{
    convert::site::{
        NamedLocation, area_from_wire, area_to_wire, location_from_wire, named_location_to_wire, point_to_wire,
    },
    v1,
};

use super::StateName;
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

/// An area that nothing is planned through.
#[derive(Clone, Debug, PartialEq)]
pub struct NoGoArea {
    /// Name of the area.
    pub name: StateName,
    /// The corners in order: x, y in metres.
    pub corners_m: Vec<[f64; 2]>,
}

impl Client {
    /// Sets an area that nothing is planned through, or replaces the area of that name.
    ///
    /// # Errors
    /// [`Error`]; the code is `INVALID_ARGUMENT` if it is no polygon.
    pub async fn set_no_go(&self, map: &str, area: &NoGoArea) -> Result<(), Error> {
        let NoGoArea { name, corners_m } = area;
        let request = v1::SetNoGoRequest { map: map.to_owned(), area: Some(area_to_wire(name, corners_m)) };
        self.map_service().set_no_go(request).await.map(drop).map_err(|status| self.error(&status))
    }

    /// Deletes an area.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or the area does not exist.
    pub async fn delete_no_go(&self, map: &str, area: &str) -> Result<(), Error> {
        let request = v1::DeleteNoGoRequest { map: map.to_owned(), area: area.to_owned() };
        self.map_service().delete_no_go(request).await.map(drop).map_err(|status| self.error(&status))
    }

    /// The areas of a map, by name.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn no_go(&self, map: &str) -> Result<Vec<NoGoArea>, Error> {
        let request = v1::ListNoGoRequest { map: map.to_owned() };
        let answer = self.map_service().list_no_go(request).await.map_err(|status| self.error(&status))?;
        let area = |area| {
            let (name, corners_m) = area_from_wire(Some(area)).map_err(|_| Error::Protocol("an area is not valid"))?;
            Ok(NoGoArea { name, corners_m })
        };
        answer.into_inner().areas.into_iter().map(area).collect()
    }
}
