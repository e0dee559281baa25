//! `PredictGrid`: a grid, or a part of it, at one time.
//!
//! Invariant: the whole answer is from one view. Its cost is reported and checked before anything is computed.

use std::sync::Arc;

use tidemap_grid::predict::{GridQuestion, GridSelection};
use tidemap_map::view::MapView;
use tidemap_proto::{
    convert::cells::{header_to_wire, question_from_wire, tile_bytes, tile_to_wire},
    v1::{self, predict_grid_response::Message},
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

use super::Queries;
use crate::rpc::{
    lookup::{check_limit, find_published, opened},
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
    if !question.selector.is_of_generation() {
        opened(&handle).await?;
    }
    let view = handle.view();
    let no_grid = || RpcError::NoGrid { map: view.spec().name.as_str().to_owned() };
    view.grid().ok_or_else(no_grid)?;
    let permit = queries.permits.take().await?;
    // This looks at every tile of the map at most, some milliseconds. The permit is held until it ends.
    let for_selection = Arc::clone(&view);
    let select = move || (permit, for_selection.grid().map(|grid| grid.select(&question)));
    let (permit, selection) = tokio::task::spawn_blocking(select).await.map_err(|_| RpcError::Stopping)?;
    let (grid, selection) = view.grid().zip(selection).ok_or_else(no_grid)?;
    let header = header_to_wire(grid, view.generation(), &question, &selection);
    let header = v1::PredictGridResponse { message: Some(Message::Header(header)) };
    if request.estimate_only {
        let (reply, replies) = mpsc::channel(1);
        // The channel has room for one reply, and the reader is still here.
        let _ = reply.try_send(Ok(header));
        return Ok(ReceiverStream::new(replies));
    }
    check_limit("cells to predict", selection.cells, queries.max_predictions, "setting max_predictions")?;
    drop(permit);
    let permit = queries.permit_for(selection.cells).await?;
    Ok(compute_replies(vec![permit], move |sink| {
        if !sink.send(header) {
            return Ok(());
        }
        predict(&view, &question, &selection, sink)
    }))
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
