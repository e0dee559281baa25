//! Cells of a grid whose change alarm rings.
//!
//! Invariant: each cell has a valid name and a date; anything else is an error.

use tidemap_proto::{
    convert::{grid::cell_box_to_wire, time::instant},
    v1,
};
use tonic::Streaming;

use crate::{
    connection::Client,
    error::Error,
    maps::{CellBox, CellIndex},
};

/// A cell whose change alarm rings.
#[derive(Clone, Debug, PartialEq)]
pub struct CellAlarm {
    /// The location of the cell.
    pub cell: CellIndex,
    /// The local date, YYYY-MM-DD, from which recent errors differ from their history.
    pub change_date: String,
    /// Mean of the learned observations.
    pub mean: f64,
    /// Number of observations that updates have learned.
    pub learned_observations: u64,
    /// Number of components that predictions use.
    pub order: u32,
    /// Time and value of the newest observation, nanoseconds UTC.
    pub last: Option<(i64, f64)>,
}

/// A reply in progress.
#[derive(Debug)]
pub struct CellAlarms {
    client: Client,
    replies: Streaming<v1::ListCellAlarmsResponse>,
}

impl Client {
    /// Lists the cells of a region, or of the whole grid, whose change alarm rings. [`CellAlarms::next`] returns them.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist, `FAILED_PRECONDITION` if it has no grid,
    /// `RESOURCE_EXHAUSTED` if the region has more cells than the limit.
    pub async fn cell_alarms(&self, map: &str, region: Option<CellBox>) -> Result<CellAlarms, Error> {
        let region = region.as_ref().map(cell_box_to_wire);
        let request = v1::ListCellAlarmsRequest { map: map.to_owned(), region };
        let answer = self.query_service().list_cell_alarms(request).await.map_err(|status| self.error(&status))?;
        Ok(CellAlarms { client: self.clone(), replies: answer.into_inner() })
    }
}

impl CellAlarms {
    /// The next cells; `None` after the last.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn next(&mut self) -> Result<Option<Vec<CellAlarm>>, Error> {
        let Some(reply) = self.replies.message().await.map_err(|status| self.client.error(&status))? else {
            return Ok(None);
        };
        reply.cells.into_iter().map(from_wire).collect::<Result<_, _>>().map(Some)
    }
}

fn from_wire(wire: v1::CellAlarm) -> Result<CellAlarm, Error> {
    let Some(Ok(cell)) = CellIndex::from_name(&wire.state) else {
        return Err(Error::Protocol("an alarm of something that is no cell"));
    };
    if wire.change_date.is_empty() {
        return Err(Error::Protocol("an alarm without a date"));
    }
    Ok(CellAlarm {
        cell,
        change_date: wire.change_date,
        mean: wire.mean,
        learned_observations: wire.learned_observations,
        order: wire.order,
        last: instant(wire.last_time).zip(wire.last_value),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_alarm_names_a_cell_and_a_date() {
        let wire = v1::CellAlarm {
            state: "cell/-1/2/0".to_owned(),
            change_date: "2025-03-01".to_owned(),
            mean: 0.25,
            ..v1::CellAlarm::default()
        };
        let found = from_wire(wire.clone()).expect("valid");
        assert_eq!((found.cell, found.mean, found.last), ([-1, 2, 0].into(), 0.25, None));
        for state in ["door", "cell/1/2"] {
            assert!(from_wire(v1::CellAlarm { state: state.to_owned(), ..wire.clone() }).is_err(), "{state}");
        }
        assert!(from_wire(v1::CellAlarm { change_date: String::new(), ..wire }).is_err());
    }
}
