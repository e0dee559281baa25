//! Predicted flows of people: cells of a raster with their expected detections and directions.
//!
//! Invariant: each requested time is answered once, in order; cells lie in the raster of the header. A reply that omits
//! or reorders anything is an error.

pub use tidemap_model::models::FlowRaster;
use tidemap_proto::{
    convert::{query::flow_source_to_wire, time::duration},
    v1::{self, predict_flow_response::Message},
};

pub use tidemap_proto::convert::query::{AvoidedPeople, FlowSource, PositionRegion};

use crate::{connection::Client, error::Error};

/// The flows of some times.
#[derive(Clone, Debug, PartialEq)]
pub struct Flows {
    /// The raster.
    pub raster: FlowRaster,
    /// Number of directions. The first is the x axis, the others follow counter-clockwise.
    pub directions: usize,
    /// Number of detections on which the model was trained.
    pub detections: u64,
    /// Number of cells whose detections have a rhythm.
    pub rhythmic_cells: u32,
    /// Number of updates published so far.
    pub generation: u64,
    /// For each time the cells with detections, ascending by index.
    pub times: Vec<Vec<FlowForecast>>,
}

/// The forecast of the flow in one cell.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowForecast {
    /// Index of the cell in the raster.
    pub cell: usize,
    /// Expected number of detections in the window.
    pub expected_count: f64,
    /// Probability of each direction of a detection.
    pub shares: Vec<f64>,
}

impl FlowForecast {
    /// The likeliest direction in radians, counter-clockwise from the x axis, in [-π, π), and its probability.
    #[must_use]
    pub fn likeliest(&self) -> (f64, f64) {
        let best = self.shares.iter().enumerate().max_by(|one, other| one.1.total_cmp(other.1));
        let (index, share) = best.map_or((0, 0.0), |(index, share)| (index, *share));
        let turns = index as f64 / self.shares.len().max(1) as f64;
        ((turns - if turns < 0.5 { 0.0 } else { 1.0 }) * std::f64::consts::TAU, share)
    }
}

impl Client {
    /// Predicts the flows of a source at some times, nanoseconds UTC, at least one: detections in windows of this
    /// length around them, nanoseconds; the daemon's default if absent.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or a state does not exist, `INVALID_ARGUMENT` if the states do not
    /// fit or the raster is too large, `FAILED_PRECONDITION` if there is nothing to learn from.
    pub async fn flows(
        &self,
        map: &str,
        source: FlowSource,
        times: &[i64],
        count_window: Option<i64>,
    ) -> Result<Flows, Error> {
        let request = v1::PredictFlowRequest {
            map: map.to_owned(),
            source: Some(flow_source_to_wire(source)),
            times_nanos: times.to_vec(),
            count_window: count_window.map(duration),
        };
        let answer = self.query_service().predict_flow(request).await;
        let mut replies = answer.map_err(|status| self.error(&status))?.into_inner();
        let first = replies.message().await.map_err(|status| self.error(&status))?;
        let Some(Message::Header(header)) = first.and_then(|reply| reply.message) else {
            return Err(Error::Protocol("a flow does not begin with its header"));
        };
        let mut flows = begun(&header, times.len())?;
        while let Some(reply) = replies.message().await.map_err(|status| self.error(&status))? {
            let Some(Message::Cells(cells)) = reply.message else {
                return Err(Error::Protocol("a flow without cells"));
            };
            flows.add(cells)?;
        }
        // Somebody was detected somewhere, so that each time has cells.
        let is_whole = flows.times.iter().all(|cells| !cells.is_empty());
        if is_whole { Ok(flows) } else { Err(Error::Protocol("a flow ends before its last time")) }
    }
}

/// The flows of a header, without cells yet.
fn begun(header: &v1::FlowHeader, times: usize) -> Result<Flows, Error> {
    let (&[low_x, low_y], &[width, height]) = (header.low_m.as_slice(), header.counts.as_slice()) else {
        return Err(Error::Protocol("the cells of a flow have no place"));
    };
    Ok(Flows {
        raster: FlowRaster {
            low_m: [low_x, low_y],
            edge_m: header.resolution_m,
            counts: [width as usize, height as usize],
        },
        directions: header.directions as usize,
        detections: header.detections,
        rhythmic_cells: header.rhythmic_cells,
        generation: header.generation,
        times: vec![Vec::new(); times],
    })
}

impl Flows {
    fn add(&mut self, piece: v1::FlowCells) -> Result<(), Error> {
        let v1::FlowCells { time_index, indices, expected_counts, shares } = piece;
        let is_whole = expected_counts.len() == indices.len() && shares.len() == indices.len() * self.directions;
        let cells = self.times.get_mut(time_index as usize).filter(|_| is_whole && self.directions > 0);
        let cells = cells.ok_or(Error::Protocol("a flow is not the one that was requested"))?;
        for ((&cell, &expected_count), shares) in
            indices.iter().zip(&expected_counts).zip(shares.chunks(self.directions))
        {
            if cell as usize >= self.raster.cells() || cells.last().is_some_and(|last| last.cell >= cell as usize) {
                return Err(Error::Protocol("a cell is not in the raster, or comes twice"));
            }
            cells.push(FlowForecast { cell: cell as usize, expected_count, shares: shares.to_vec() });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn header() -> v1::FlowHeader {
        v1::FlowHeader {
            low_m: vec![1.0, 2.0],
            resolution_m: 0.5,
            counts: vec![3, 2],
            directions: 4,
            ..v1::FlowHeader::default()
        }
    }

    #[test]
    fn pieces_of_a_reply_add_up() {
        let mut flows = begun(&header(), 2).expect("right");
        let piece = |time_index, cell| v1::FlowCells {
            time_index,
            indices: vec![cell],
            expected_counts: vec![2.0],
            shares: vec![0.1, 0.2, 0.6, 0.1],
        };
        flows.add(piece(1, 0)).expect("right");
        flows.add(piece(1, 5)).expect("right");
        assert_eq!((flows.times[0].len(), flows.times[1].len()), (0, 2));
        assert_eq!(flows.times[1][1].likeliest(), (-PI, 0.6));
        assert!(flows.add(piece(2, 0)).is_err() && flows.add(piece(0, 6)).is_err());
        assert!(flows.add(v1::FlowCells { shares: vec![1.0], ..piece(0, 0) }).is_err());
        assert!(begun(&v1::FlowHeader { counts: vec![3], ..header() }, 1).is_err());
    }

    #[test]
    fn directions_are_angles() {
        let at = |index: usize| {
            let mut shares = vec![0.0; 8];
            shares[index] = 1.0;
            FlowForecast { cell: 0, expected_count: 1.0, shares }.likeliest().0
        };
        assert_eq!([at(0), at(2), at(4), at(6)], [0.0, PI / 2.0, -PI, -PI / 2.0]);
    }
}
