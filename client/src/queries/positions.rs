//! Predicted positions: cells of a region with their probabilities.
//!
//! Invariant: each requested time is answered once, in order; cells lie in the region of the header. A reply that omits
//! or reorders anything is an error.

use tidemap_proto::{
    convert::{
        query::selector_to_wire,
        time::{duration, instant},
    },
    v1::{self, predict_positions_response::Message},
};
use tonic::Streaming;

use super::ModelSelector;
use crate::{connection::Client, error::Error};

/// A request for positions of a vector.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PositionQuery {
    /// Times, nanoseconds UTC; at least one.
    pub times: Vec<i64>,
    /// The model that predicts: hypertime-em or hypertime-km; the daemon's default if absent.
    pub model: Option<ModelSelector>,
    /// Lower and upper corner of the region, metres; by default the observations with a margin.
    pub region_m: Option<(Vec<f64>, Vec<f64>)>,
    /// Edge of a cell, metres; the daemon's default if absent.
    pub resolution_m: Option<f64>,
    /// Maximum number of cells of each time, the most probable ones; all if absent.
    pub top: Option<u32>,
    /// Also predicts how many positions there are from each time until this much later, nanoseconds.
    pub count_window: Option<i64>,
}

/// The header of a reply.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PositionsHeader {
    /// Lower corner of the first cell, metres.
    pub low_m: Vec<f64>,
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Number of cells along each axis.
    pub counts: Vec<u32>,
    /// Number of acknowledged positions.
    pub observations: u64,
    /// Number of positions that the model was trained on.
    pub trained_observations: u64,
    /// Time of the newest observation.
    pub last_nanos: Option<i64>,
    /// Number of updates published so far.
    pub generation: u64,
}

/// The predicted position at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PositionForecast {
    /// Index of the time in the request.
    pub time: usize,
    /// Expected position, metres.
    pub expected_m: Vec<f64>,
    /// Probability that the position is outside the cells of the region.
    pub outside: f64,
    /// Expected number of positions in the window, in all cells together; for one cell, multiply it by the cell's
    /// probability. 0 without a window.
    pub expected_count: f64,
    /// Centre of each cell in metres, and its probability; most probable first.
    pub cells: Vec<(Vec<f64>, f64)>,
}

/// A reply in progress.
#[derive(Debug)]
pub struct Positions {
    client: Client,
    replies: Streaming<v1::PredictPositionsResponse>,
    header: PositionsHeader,
    times: usize,
    /// The first piece of the next time.
    begun: Option<v1::PositionCells>,
    next: usize,
}

impl Client {
    /// Predicts the positions of a vector, and waits for the header of the reply.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist, `INVALID_ARGUMENT` if the state is not a
    /// vector or the request is invalid, `FAILED_PRECONDITION` if the vector is untrained.
    pub async fn positions(&self, map: &str, state: &str, query: PositionQuery) -> Result<Positions, Error> {
        let times = query.times.len();
        let request = v1::PredictPositionsRequest {
            map: map.to_owned(),
            state: state.to_owned(),
            times_nanos: query.times,
            model: query.model.map(selector_to_wire),
            region: query.region_m.map(|(low_m, high_m)| v1::PositionBox { low_m, high_m }),
            resolution_m: query.resolution_m.unwrap_or_default(),
            top: query.top.unwrap_or_default(),
            count_window: query.count_window.map(duration),
        };
        let answer = self.query_service().predict_positions(request).await;
        let mut replies = answer.map_err(|status| self.error(&status))?.into_inner();
        let first = replies.message().await.map_err(|status| self.error(&status))?;
        let Some(Message::Header(header)) = first.and_then(|reply| reply.message) else {
            return Err(Error::Protocol("positions do not begin with their header"));
        };
        let header = PositionsHeader {
            low_m: header.low_m,
            resolution_m: header.resolution_m,
            counts: header.counts,
            observations: header.observations,
            trained_observations: header.trained_observations,
            last_nanos: instant(header.last_time),
            generation: header.generation,
        };
        if header.low_m.len() != header.counts.len() {
            return Err(Error::Protocol("the cells of positions have no place"));
        }
        Ok(Positions { client: self.clone(), replies, header, times, begun: None, next: 0 })
    }
}

impl PositionsHeader {
    /// The centre of a cell by its index, metres; `None` if there is no such cell.
    #[must_use]
    pub fn middle_m(&self, index: u32) -> Option<Vec<f64>> {
        let mut rest = index;
        let mut middle = Vec::with_capacity(self.counts.len());
        for (&count, low) in self.counts.iter().zip(&self.low_m) {
            middle.push(low + self.resolution_m * (f64::from(rest.checked_rem(count)?) + 0.5));
            rest /= count;
        }
        (rest == 0).then_some(middle)
    }
}

impl Positions {
    /// The header of a reply.
    #[must_use]
    pub fn header(&self) -> &PositionsHeader {
        &self.header
    }

    /// The forecast of the next time; `None` after the last.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn next(&mut self) -> Result<Option<PositionForecast>, Error> {
        let first = match self.begun.take() {
            Some(first) => Some(first),
            None => self.piece().await?,
        };
        let Some(first) = first else {
            return if self.next == self.times { Ok(None) } else { Err(Error::Protocol("positions are missing")) };
        };
        if first.time_index as usize != self.next || self.next >= self.times {
            return Err(Error::Protocol("positions are not those that were requested"));
        }
        let mut forecast = PositionForecast { time: self.next, ..PositionForecast::default() };
        forecast.expected_m.clone_from(&first.expected_m);
        forecast.outside = first.outside;
        forecast.expected_count = first.expected_count;
        let time_index = first.time_index;
        let mut piece = Some(first);
        while let Some(cells) = piece.take_if(|cells| cells.time_index == time_index) {
            for (&index, &probability) in cells.indices.iter().zip(&cells.probabilities) {
                let middle = self.header.middle_m(index).ok_or(Error::Protocol("a cell is not in the region"))?;
                forecast.cells.push((middle, probability));
            }
            piece = self.piece().await?;
        }
        self.begun = piece;
        self.next += 1;
        Ok(Some(forecast))
    }

    async fn piece(&mut self) -> Result<Option<v1::PositionCells>, Error> {
        let reply = self.replies.message().await.map_err(|status| self.client.error(&status))?;
        match reply.map(|reply| reply.message) {
            None => Ok(None),
            Some(Some(Message::Cells(cells))) if cells.indices.len() == cells.probabilities.len() => Ok(Some(cells)),
            Some(_) => Err(Error::Protocol("positions without cells")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbered_along_x_then_y_then_z() {
        let header = PositionsHeader {
            low_m: vec![10.0, -1.0, 0.0],
            resolution_m: 0.5,
            counts: vec![4, 3, 2],
            ..PositionsHeader::default()
        };
        assert_eq!(header.middle_m(0), Some(vec![10.25, -0.75, 0.25]));
        assert_eq!(header.middle_m(5), Some(vec![10.75, -0.25, 0.25]));
        assert_eq!(header.middle_m(23), Some(vec![11.75, 0.25, 0.75]));
        assert_eq!(header.middle_m(24), None);
        assert_eq!(PositionsHeader { low_m: vec![0.0], counts: vec![0], ..header }.middle_m(0), None);
    }
}
