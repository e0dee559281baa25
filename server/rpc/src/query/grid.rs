//! `PredictGrid`: a grid, or a part of it, at one time.
//!
//! Invariant: the whole answer is from one view. Its cost is reported and checked before anything is computed.

use std::sync::Arc;

use tidemap_grid::predict::{GridQuestion, GridSelection, TileCells};
use tidemap_ingest::handle::MapHandle;
use tidemap_map::view::MapView;
use tidemap_model::selector::ModelSelector;
use tidemap_proto::{
    convert::cells::{header_to_wire, question_from_wire, tile_bytes, tile_to_wire},
    v1::{self, predict_grid_response::Message},
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

use super::Queries;
use crate::{
    lookup::{check_limit, find_published, opened},
    permits::{Permit, run_blocking, run_while_awaited},
    replies::{Replies, ReplySink, compute_replies},
    status::RpcError,
};

/// A page is sent when it has this many bytes.
const PAGE_BYTES: usize = 128 << 10;

pub(super) async fn predict_grid(
    queries: &Queries,
    request: v1::PredictGridRequest,
) -> Result<Replies<v1::PredictGridResponse>, RpcError> {
    let handle = find_published(&queries.catalog, &request.map)?;
    let question = question_from_wire(&request)?;
    let view = grid_view(&handle, question.selector).await?;
    let selection = queries.select_cells(&view, question).await?;
    let grid = view.grid().ok_or_else(|| no_grid(&view))?;
    let header = header_to_wire(grid, view.generation(), &question, &selection);
    let header = v1::PredictGridResponse { message: Some(Message::Header(header)) };
    if request.estimate_only {
        let (reply, replies) = mpsc::channel(1);
        // The channel has room for one reply, and the reader is still here.
        let _ = reply.try_send(Ok(header));
        return Ok(ReceiverStream::new(replies));
    }
    let permit = queries.permit_for_cells(&selection).await?;
    Ok(compute_replies(vec![permit], move |sink| {
        if !sink.send(header) {
            return Ok(());
        }
        predict(&view, &question, &selection, sink)
    }))
}

fn no_grid(view: &MapView) -> RpcError {
    RpcError::NoGrid { map: view.spec().name.as_str().to_owned() }
}

/// The view that predicts the grid of a map with this model.
async fn grid_view(handle: &MapHandle, selector: ModelSelector) -> Result<Arc<MapView>, RpcError> {
    if !selector.is_of_generation() {
        opened(handle).await?;
    }
    let view = handle.view();
    if view.grid().is_some() { Ok(view) } else { Err(no_grid(&view)) }
}

/// The steps of an answer about a grid; the answer's form is up to the caller.
impl Queries {
    /// The view of a map with a grid that predicts with this model.
    ///
    /// # Errors
    /// There is no such map for the caller, it has no grid, or it does not open in time.
    pub async fn grid_view(&self, map: &str, selector: ModelSelector) -> Result<Arc<MapView>, RpcError> {
        grid_view(&*find_published(&self.catalog, map)?, selector).await
    }

    /// Selects the tiles of a question.
    ///
    /// # Errors
    /// Too many requests compute, or the view has no grid.
    pub async fn select_cells(&self, view: &Arc<MapView>, question: GridQuestion) -> Result<GridSelection, RpcError> {
        let permit = self.permits.take().await?;
        let for_selection = Arc::clone(view);
        // This reads every tile of the map at most, in some milliseconds. The permit is held until it ends.
        let select = move || for_selection.grid().map(|grid| grid.select(&question));
        run_blocking(permit, select).await?.ok_or_else(|| no_grid(view))
    }

    /// Takes a permit to predict selected cells.
    async fn permit_for_cells(&self, selection: &GridSelection) -> Result<Permit, RpcError> {
        check_limit("cells to predict", selection.cells, self.max_predictions, "setting max_predictions")?;
        self.permit_for(selection.cells).await
    }

    /// Predicts selected cells, and adds each tile to `sum`. It ends early when nobody waits for it any more.
    ///
    /// # Errors
    /// There are more cells than the limit, too many requests compute, or a tile cannot be read.
    pub async fn sum_cells<T: Send + 'static>(
        &self,
        view: &Arc<MapView>,
        (question, selection): (GridQuestion, GridSelection),
        mut sum: T,
        add: impl Fn(&mut T, &TileCells) + Send + 'static,
    ) -> Result<T, RpcError> {
        let mut permit = self.permit_for_cells(&selection).await?;
        let view = Arc::clone(view);
        run_while_awaited((), None, move |stop| {
            for tile in view.predict_grid(&question, &selection) {
                if stop.is_set() {
                    break;
                }
                add(&mut sum, &tile?);
                permit.offer();
            }
            Ok(sum)
        })
        .await?
    }
}

/// Computes the pages until all are sent or the client is gone.
fn predict(
    view: &MapView,
    question: &GridQuestion,
    selection: &GridSelection,
    sink: &ReplySink<v1::PredictGridResponse>,
) -> Result<(), RpcError> {
    let levels = view.grid().map_or((0.0, 1.0), tidemap_grid::view::GridView::levels);
    let send = |tiles| sink.send(v1::PredictGridResponse { message: Some(Message::Page(v1::GridPage { tiles })) });
    let (mut page, mut bytes) = (Vec::new(), 0);
    for tile in view.predict_grid(question, selection) {
        if sink.is_closed() {
            return Ok(());
        }
        let tile = tile_to_wire(tile?, question, levels);
        bytes += tile_bytes(&tile);
        page.push(tile);
        if bytes >= PAGE_BYTES {
            bytes = 0;
            if !send(std::mem::take(&mut page)) {
                return Ok(());
            }
        }
    }
    if !page.is_empty() {
        send(page);
    }
    Ok(())
}
