//! `PredictFlow`: how many people will be detected in the cells of a raster, and in which directions they move.
//!
//! Invariant: the shares of a cell sum to 1. The number of predictions is checked before they are computed.

use tidemap_model::models::{FlowModel, Moment};
use tidemap_proto::{
    convert::query::{flow_cells_to_wire, flow_from_wire, flow_header_to_wire},
    v1::{self, predict_flow_response::Message},
};

use super::Queries;
use crate::{
    lookup::{check_limit, find_map},
    permits::run_blocking,
    replies::{Replies, ReplySink, stream_replies},
    status::RpcError,
};

/// Number of shares in one reply, for all its cells.
const SHARES_PER_REPLY: usize = 131_072;

pub(super) async fn predict_flow(
    queries: &Queries,
    request: v1::PredictFlowRequest,
) -> Result<Replies<v1::PredictFlowResponse>, RpcError> {
    let handle = find_map(&queries.catalog, &request.map).await?;
    let question = flow_from_wire(request)?;
    let view = handle.view();
    let flow = queries.trainer.flow(&handle, &view, ("source", &question.source)).await?;
    let predictions = (flow.cells() as u64).saturating_mul(question.times_nanos.len() as u64);
    check_limit("cells of all times", predictions, queries.max_predictions, "setting max_predictions")?;
    let (moments, permits) = (view.moments(&question.times_nanos), queries.large_permits.clone());
    let window_secs = question.window_nanos as f64 / 1e9;
    Ok(stream_replies(move |sink| async move {
        let sink = sink.holding(vec![permits.take().await?]);
        let predict = move || {
            let header = Message::Header(flow_header_to_wire(&flow, view.generation()));
            if sink.send(v1::PredictFlowResponse { message: Some(header) }) {
                send_cells(&flow, &moments, window_secs, &sink);
            }
        };
        run_blocking((), predict).await
    }))
}

/// Computes and sends the cells of each time, until the client is gone.
fn send_cells(flow: &FlowModel, moments: &[Moment], window_secs: f64, sink: &ReplySink<v1::PredictFlowResponse>) {
    let cells_per_reply = (SHARES_PER_REPLY / flow.options().directions).max(1);
    for (time_index, &moment) in (0..).zip(moments) {
        for piece in flow.at(moment).chunks(cells_per_reply) {
            let cells = Message::Cells(flow_cells_to_wire(time_index, piece, window_secs));
            if !sink.send(v1::PredictFlowResponse { message: Some(cells) }) {
                return;
            }
        }
    }
}
