//! The exported content of a map at one time: its grid, its topological map with costs, and its states.
//!
//! Invariant: everything is requested for the given time; content that does not exist in the map is `None` or empty,
//! never a guess.

use std::collections::HashMap;

use tidemap_client::{
    maps::NoGoArea,
    queries::{GridOutput, GridQuery, ModelSelector},
    routes::{EdgePrediction, StateName, expected_secs},
};
use tidemap_formats::{
    MapPicture, PictureValue,
    map_recording::messages::StateValue,
    route_graph::{self, EdgeCost, GraphHead, RouteGraph},
};
use tidemap_model::Dimensions;

use super::super::{
    Session,
    grid::{
        place::{AxisRange, Rectangle},
        predict::{self, usual_region},
    },
    predict::check_for_cells,
};

/// The options of the requests for a map.
#[derive(Clone, Debug)]
pub(crate) struct FrameOptions {
    /// Name of the map.
    pub(crate) map: String,
    /// The model of cells, states and edges.
    pub(crate) model: ModelSelector,
    /// Only cells in this rectangle.
    pub(crate) region: Option<Rectangle>,
    /// Only cells between these heights.
    pub(crate) z: Option<AxisRange>,
    /// Speed on edges without data.
    pub(crate) speed_m_per_s: Option<f64>,
    /// Time to recover from a failed attempt to pass an edge.
    pub(crate) recovery_secs: f64,
    /// Confidence of the intervals of states.
    pub(crate) interval: f64,
}

/// A grid at one time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GridFrame {
    /// The frame of its origin.
    pub(crate) frame: String,
    /// The cells of the grid, in one layer.
    pub(crate) picture: MapPicture,
    /// Number of updates behind the prediction.
    pub(crate) generation: u64,
}

/// The grid of a map at a time.
pub(crate) async fn grid(session: &Session, options: &FrameOptions, time_nanos: i64) -> anyhow::Result<GridFrame> {
    check_for_cells(options.model)?;
    let query = GridQuery {
        map: options.map.clone(),
        time_nanos,
        model: options.model,
        region: usual_region(session, &options.map, options.region, options.z).await?,
        is_projected: true,
        output: GridOutput::Probability,
    };
    let predicted = predict::predicted(session, &query).await?;
    Ok(GridFrame {
        frame: predicted.header.grid.frame_id.clone(),
        generation: predicted.header.generation,
        picture: predict::picture(&predicted, PictureValue::Probability),
    })
}

/// The no-go areas of a map, by name.
pub(crate) async fn areas(session: &Session, map: &str) -> anyhow::Result<Vec<(StateName, Vec<[f64; 2]>)>> {
    let areas = session.client.no_go(map).await?;
    Ok(areas.into_iter().map(|NoGoArea { name, corners_m }| (name, corners_m)).collect())
}

/// The topological map at a time, with the cost of each edge. `None`: the map has no nodes.
pub(crate) async fn topology(
    session: &Session,
    options: &FrameOptions,
    time_nanos: i64,
    frame: &str,
) -> anyhow::Result<Option<RouteGraph>> {
    let FrameOptions { map, model, speed_m_per_s, recovery_secs, .. } = options;
    let topology = session.client.topology(map).await?;
    if topology.nodes().len() == 0 {
        return Ok(None);
    }
    let forecasts = session.client.predict_edges(map, time_nanos, *model, *speed_m_per_s).await?;
    let cost = |EdgePrediction { edge, success, duration_secs, .. }| {
        let expected_secs = expected_secs(success, duration_secs, *recovery_secs);
        (edge, EdgeCost { success, duration_secs, expected_secs })
    };
    let costs: HashMap<_, _> = forecasts.into_iter().map(cost).collect();
    let areas = areas(session, map).await?;
    Ok(Some(route_graph::write(topology, &costs, &areas, GraphHead { map, frame, time_nanos })?))
}

/// The states of a map at a time, in the order of `names`; a vector has one for each axis, and a categorical state one
/// for each label.
pub(crate) async fn states(
    session: &Session,
    options: &FrameOptions,
    time_nanos: i64,
    names: &[String],
) -> anyhow::Result<Vec<(String, StateValue)>> {
    let predictions = session.client.predict(&options.map, names.to_vec(), vec![time_nanos], options.model);
    let mut predictions = predictions.with_intervals(options.interval);
    let mut values = Vec::with_capacity(names.len());
    while let Some(run) = predictions.next().await? {
        let Some(&value) = run.probabilities.first() else { continue };
        let axis = run.axis.and_then(|axis| Dimensions::Three.axes().get(axis)).copied();
        let state = &predictions.states()[run.state];
        let name = match run.label.as_deref().or(axis) {
            Some(part) => format!("{state}/{part}"),
            None => state.clone(),
        };
        values.push((name, StateValue { value, low: run.lower.first().copied(), high: run.upper.first().copied() }));
    }
    Ok(values)
}
