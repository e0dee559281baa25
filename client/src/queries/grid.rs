//! The predicted grid at one time, past or future.
//!
//! Invariant: every announced tile arrives, each once and in order; a missing part is an error, never unknown cells.

mod tile;

use tidemap_grid::predict::{CellOutput, GridQuestion};
use tidemap_proto::{
    convert::cells::{header_from_wire, question_to_wire},
    v1::{self, predict_grid_response::Message},
};
use tonic::Streaming;

pub use tidemap_grid::predict::CellPrediction;
pub use tidemap_proto::convert::cells::GridHeader;
pub use tile::PredictedTile;

use super::ModelSelector;
use crate::{connection::Client, error::Error, maps::CellBox};

/// Number of cells along the edge of a tile.
pub const TILE_EDGE: i32 = 8;

/// The output for each cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum GridOutput {
    /// Probability that it is occupied.
    #[default]
    Probability,
    /// Entropy of the prediction in bits.
    Entropy,
    /// 1 if the probability is at least this, else 0.
    Threshold(f64),
}

/// A request for a prediction of a grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GridQuery {
    /// Name of the map.
    pub map: String,
    /// Time, nanoseconds UTC.
    pub time_nanos: i64,
    /// The model that predicts.
    pub model: ModelSelector,
    /// The cells to predict; all if absent.
    pub region: Option<CellBox>,
    /// Whether to project the region along z to one layer: a column gets the value of its most probable known cell.
    pub is_projected: bool,
    /// The output for each cell.
    pub output: GridOutput,
}

/// A reply in progress.
#[derive(Debug)]
pub struct GridPrediction {
    client: Client,
    header: GridHeader,
    is_projected: bool,
    replies: Streaming<v1::PredictGridResponse>,
    received: u64,
    /// Index of the last tile: z, y, x.
    last: Option<[i32; 3]>,
}

/// A complete reply.
#[derive(Clone, Debug, PartialEq)]
pub struct WholeGrid {
    /// The header.
    pub header: GridHeader,
    /// The tiles, by z, then y, then x.
    pub tiles: Vec<PredictedTile>,
}

impl Client {
    /// Predicts the grid at one time. [`GridPrediction::next`] returns its tiles.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist, `FAILED_PRECONDITION` if it has no grid,
    /// `RESOURCE_EXHAUSTED` if the region has more cells than the limit.
    pub async fn predict_grid(&self, query: &GridQuery) -> Result<GridPrediction, Error> {
        self.send_query(query, false).await
    }

    /// The header of the reply, without the tiles.
    ///
    /// # Errors
    /// The errors of [`Client::predict_grid`].
    pub async fn estimate_grid(&self, query: &GridQuery) -> Result<GridHeader, Error> {
        self.send_query(query, true).await.map(|answer| answer.header)
    }

    async fn send_query(&self, query: &GridQuery, estimate_only: bool) -> Result<GridPrediction, Error> {
        let output = match query.output {
            GridOutput::Probability => CellOutput::Probability,
            GridOutput::Entropy => CellOutput::Entropy,
            GridOutput::Threshold(threshold) => CellOutput::Threshold(threshold as f32),
        };
        let question = GridQuestion {
            utc_nanos: query.time_nanos,
            selector: query.model,
            region: query.region,
            project: query.is_projected,
            output,
        };
        let mut request = question_to_wire(&query.map, &question, estimate_only);
        if let GridOutput::Threshold(threshold) = query.output {
            // The request keeps all digits: the daemon checks them.
            request.threshold = threshold;
        }
        let answer = self.query_service().predict_grid(request).await.map_err(|status| self.error(&status))?;
        let mut replies = answer.into_inner();
        let first = replies.message().await.map_err(|status| self.error(&status))?;
        let Some(Message::Header(header)) = first.and_then(|reply| reply.message) else {
            return Err(Error::Protocol("no header of a grid"));
        };
        let header = header_from_wire(header).map_err(|_| Error::Protocol("an invalid grid"))?;
        let is_projected = query.is_projected;
        Ok(GridPrediction { client: self.clone(), header, is_projected, replies, received: 0, last: None })
    }
}

impl GridPrediction {
    /// The header.
    #[must_use]
    pub fn header(&self) -> &GridHeader {
        &self.header
    }

    /// The next tiles; `None` after the last.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn next(&mut self) -> Result<Option<Vec<PredictedTile>>, Error> {
        let Some(reply) = self.replies.message().await.map_err(|status| self.client.error(&status))? else {
            if self.received != self.header.tiles {
                return Err(Error::Protocol("tiles of a grid are missing"));
            }
            return Ok(None);
        };
        let Some(Message::Page(page)) = reply.message else { return Err(Error::Protocol("no page of a grid")) };
        let tiles: Vec<PredictedTile> = page
            .tiles
            .into_iter()
            .map(|tile| PredictedTile::from_wire(tile, self.is_projected))
            .collect::<Result<_, _>>()?;
        for tile in &tiles {
            let [x, y, z] = tile.place;
            if self.last.replace([z, y, x]).is_some_and(|last| last >= [z, y, x]) {
                return Err(Error::Protocol("tiles of a grid are out of order"));
            }
        }
        self.received += tiles.len() as u64;
        Ok(Some(tiles))
    }

    /// All tiles.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn whole(mut self) -> Result<WholeGrid, Error> {
        let mut tiles = Vec::new();
        while let Some(more) = self.next().await? {
            tiles.extend(more);
        }
        Ok(WholeGrid { header: self.header, tiles })
    }
}

impl WholeGrid {
    /// The prediction of a cell; unknown if it is not part of the reply.
    #[must_use]
    pub fn cell(&self, cell: [i32; 3]) -> CellPrediction {
        let [x, y, z] = cell.map(|index| index.div_euclid(TILE_EDGE));
        let key = |tile: &PredictedTile| [tile.place[2], tile.place[1], tile.place[0]];
        let Ok(at) = self.tiles.binary_search_by_key(&[z, y, x], key) else { return CellPrediction::Unknown };
        let [x, y, z] = cell.map(|index| index.rem_euclid(TILE_EDGE) as usize);
        self.tiles[at].cells[x + 8 * y + 64 * z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::maps::GridSpec;

    #[test]
    fn a_cell_is_found_by_its_index() {
        let tile = |place, at: usize| {
            let mut cells = Box::new([CellPrediction::Unknown; 512]);
            cells[at] = CellPrediction::Static(0.25);
            PredictedTile { place, cells }
        };
        let grid = GridSpec::new(0.1);
        let header = GridHeader { grid, region: CellBox::default(), tiles: 2, cells: 1024, bytes: 0, generation: 1 };
        let grid = WholeGrid { header, tiles: vec![tile([5, 0, -1], 511), tile([-1, 2, 0], 8)] };
        let known: Vec<[i32; 3]> = (-16..48)
            .flat_map(|x| (0..24).flat_map(move |y| (-8..8).map(move |z| [x, y, z])))
            .filter(|&cell| grid.cell(cell) != CellPrediction::Unknown)
            .collect();
        assert_eq!(known, [[-8, 17, 0], [47, 7, -1]]);
    }
}
