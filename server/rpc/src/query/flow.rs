//! `PredictFlow`: how many people will be detected in the cells of a raster, and in which directions they move.
//!
//! Invariant: the shares of a cell sum to 1. The number of predictions is checked before they are computed.

use tidemap_map::view::MapView;
use tidemap_model::models::{FlowModel, Moment};
use tidemap_proto::{
    convert::query::flow_from_wire,
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
            if sink.send(header(&view, &flow)) {
                send_cells(&flow, &moments, window_secs, &sink);
            }
        };
        run_blocking((), predict).await
    }))
}

fn header(view: &MapView, flow: &FlowModel) -> v1::PredictFlowResponse {
    let options = flow.options();
    let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    let header = v1::FlowHeader {
        low_m: options.raster.low_m.to_vec(),
        resolution_m: options.raster.edge_m,
        counts: options.raster.counts.map(number).to_vec(),
        directions: number(options.directions),
        detections: flow.detections(),
        rhythmic_cells: number(flow.orders().filter(|(_, order)| *order > 0).count()),
        generation: view.generation(),
    };
    v1::PredictFlowResponse { message: Some(Message::Header(header)) }
}

/// Computes and sends the cells of each time, until the client is gone.
fn send_cells(flow: &FlowModel, moments: &[Moment], window_secs: f64, sink: &ReplySink<v1::PredictFlowResponse>) {
    let cells_per_reply = (SHARES_PER_REPLY / flow.options().directions).max(1);
    for (time_index, &moment) in (0..).zip(moments) {
        for piece in flow.at(moment).chunks(cells_per_reply) {
            let cells = v1::FlowCells {
                time_index,
                indices: piece.iter().map(|found| u32::try_from(found.cell).unwrap_or(u32::MAX)).collect(),
                expected_counts: piece.iter().map(|found| found.total_per_sec() * window_secs).collect(),
                shares: piece.iter().flat_map(|found| found.shares()).collect(),
            };
            if !sink.send(v1::PredictFlowResponse { message: Some(Message::Cells(cells)) }) {
                return;
            }
        }
    }
}
