//! Predictions of flows: questions and replies, and people to avoid on a route.
//!
//! Invariant: numbers are finite and within range. The handler of the request checks from the map whether the states
//! are positions and have directions.

use tidemap_model::models::{CellFlow, FLOW_DIRECTIONS, FLOW_INTERVAL_NANOS, FlowModel};
use tidemap_plan::encounters::NEAR_M;

use super::positions::{PositionRegion, edge_from_wire, region_from_wire, window_from_wire};
use crate::{
    convert::{InvalidField, time::times_from_wire},
    v1,
};

/// Number of directions if none is given.
const DIRECTIONS: usize = 8;
/// Default worth of avoiding an encounter, seconds.
const ENCOUNTER_COST_SECS: f64 = 10.0;
/// The greatest distance that may count as near, metres.
const NEAR_MAX_M: f64 = 100.0;

/// Detections of moving people, and their raster.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowSource {
    /// Name of the vector of positions.
    pub state: String,
    /// Name of the angle or vector that has their directions.
    pub motion_state: String,
    /// `None`: where the detections are.
    pub region: Option<PositionRegion>,
    /// Edge of a cell, metres; `None`: the default.
    pub edge_m: Option<f64>,
    /// Number of directions, in [`FLOW_DIRECTIONS`].
    pub directions: usize,
}

/// The question for a flow.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowQuestion {
    /// The detections.
    pub source: FlowSource,
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// Length of the window in which detections are expected, nanoseconds.
    pub window_nanos: i64,
}

/// People to avoid on a route.
#[derive(Clone, Debug, PartialEq)]
pub struct AvoidedPeople {
    /// The detections of these people.
    pub source: FlowSource,
    /// Worth of avoiding an encounter, seconds.
    pub encounter_cost_secs: f64,
    /// People within this distance are near, metres.
    pub near_m: f64,
}

/// The question for a flow.
///
/// # Errors
/// The invalid field.
pub fn flow_from_wire(request: v1::PredictFlowRequest) -> Result<FlowQuestion, InvalidField> {
    let v1::PredictFlowRequest { source, times_nanos, count_window, .. } = request;
    times_from_wire("times_nanos", &times_nanos)?;
    Ok(FlowQuestion {
        source: source_from_wire("source", source)?,
        times_nanos,
        window_nanos: window_from_wire(count_window)?.unwrap_or(FLOW_INTERVAL_NANOS),
    })
}

/// The people that a route avoids; `None`: nobody.
///
/// # Errors
/// The invalid field.
pub fn avoided_from_wire(request: &v1::PlanRouteRequest) -> Result<Option<AvoidedPeople>, InvalidField> {
    let Some(source) = request.avoid_people.clone() else {
        let stray = [("encounter_cost_secs", request.encounter_cost_secs.is_some()), ("near_m", request.near_m != 0.0)];
        return match stray.into_iter().find(|(_, is_given)| *is_given) {
            Some((field, _)) => Err(InvalidField::new(field, "only with avoid_people")),
            None => Ok(None),
        };
    };
    let near_m = match request.near_m {
        0.0 => NEAR_M,
        near if near > 0.0 && near <= NEAR_MAX_M => near,
        other => return Err(InvalidField::new("near_m", format!("{other} m: expected above 0, at most {NEAR_MAX_M}"))),
    };
    let encounter_cost_secs = request.encounter_cost_secs.unwrap_or(ENCOUNTER_COST_SECS);
    let source = source_from_wire("avoid_people", Some(source))?;
    Ok(Some(AvoidedPeople { source, encounter_cost_secs, near_m }))
}

/// Detections for the wire.
#[must_use]
pub fn flow_source_to_wire(source: FlowSource) -> v1::FlowSource {
    let FlowSource { state, motion_state, region, edge_m, directions } = source;
    v1::FlowSource {
        state,
        motion_state,
        region: region.map(|PositionRegion { low_m, high_m }| v1::PositionBox { low_m, high_m }),
        resolution_m: edge_m.unwrap_or_default(),
        directions: u32::try_from(directions).unwrap_or(u32::MAX),
    }
}

/// The raster of a flow for the wire, with what it was learned from. `generation`: that of the map.
#[must_use]
pub fn flow_header_to_wire(flow: &FlowModel, generation: u64) -> v1::FlowHeader {
    let options = flow.options();
    let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    v1::FlowHeader {
        low_m: options.raster.low_m.to_vec(),
        resolution_m: options.raster.edge_m,
        counts: options.raster.counts.map(number).to_vec(),
        directions: number(options.directions),
        detections: flow.detections(),
        rhythmic_cells: number(flow.orders().filter(|(_, order)| *order > 0).count()),
        generation,
    }
}

/// Cells of a flow for the wire, at the time with this index of the question. Their detections are those that are
/// expected in a window of this length.
#[must_use]
pub fn flow_cells_to_wire(time_index: u32, cells: &[CellFlow], window_secs: f64) -> v1::FlowCells {
    v1::FlowCells {
        time_index,
        indices: cells.iter().map(|found| u32::try_from(found.cell).unwrap_or(u32::MAX)).collect(),
        expected_counts: cells.iter().map(|found| found.total_per_sec() * window_secs).collect(),
        shares: cells.iter().flat_map(CellFlow::shares).collect(),
    }
}

fn source_from_wire(field: &str, wire: Option<v1::FlowSource>) -> Result<FlowSource, InvalidField> {
    let missing = || InvalidField::new(field, "name the states with the positions of people and their directions");
    let v1::FlowSource { state, motion_state, region, resolution_m, directions } = wire.ok_or_else(missing)?;
    let at = |name: &str| format!("{field}.{name}");
    for (name, state) in [("state", &state), ("motion_state", &motion_state)] {
        if state.is_empty() {
            return Err(InvalidField::new(at(name), "name a state"));
        }
    }
    if state == motion_state {
        let text = format!("{state:?} has the positions: name a state with directions, an angle or a velocity");
        return Err(InvalidField::new(at("motion_state"), text));
    }
    let region = region.map(|region| region_from_wire(&at("region"), region)).transpose()?;
    if let Some(region) = &region
        && let Some((name, corner)) =
            [("low_m", &region.low_m), ("high_m", &region.high_m)].into_iter().find(|(_, corner)| corner.len() != 2)
    {
        let text = format!("{} coordinates: a raster has x and y", corner.len());
        return Err(InvalidField::new(format!("{field}.region.{name}"), text));
    }
    let directions = match directions as usize {
        0 => DIRECTIONS,
        known if FLOW_DIRECTIONS.contains(&known) => known,
        other => {
            let (least, greatest) = (FLOW_DIRECTIONS.start(), FLOW_DIRECTIONS.end());
            let text = format!("{other} directions: expected {least} to {greatest}, or 0 for the default");
            return Err(InvalidField::new(at("directions"), text));
        }
    };
    let edge_m = edge_from_wire(&at("resolution_m"), resolution_m)?;
    Ok(FlowSource { state, motion_state, region, edge_m, directions })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source() -> v1::FlowSource {
        let (state, motion_state) = ("people".to_owned(), "people-heading".to_owned());
        v1::FlowSource { state, motion_state, ..v1::FlowSource::default() }
    }

    fn request(source: v1::FlowSource) -> v1::PredictFlowRequest {
        v1::PredictFlowRequest { source: Some(source), times_nanos: vec![5], ..v1::PredictFlowRequest::default() }
    }

    #[test]
    fn a_plain_question_has_the_defaults() {
        let question = flow_from_wire(request(source())).expect("right");
        assert_eq!((question.window_nanos, question.source.directions), (FLOW_INTERVAL_NANOS, 8));
        assert_eq!((question.source.region.clone(), question.source.edge_m), (None, None));
        assert_eq!(source_from_wire("source", Some(flow_source_to_wire(question.source.clone()))), Ok(question.source));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |source| flow_from_wire(request(source)).expect_err("wrong").field;
        let region = |low: Vec<f64>, high: Vec<f64>| Some(v1::PositionBox { low_m: low, high_m: high });
        for (wrong, expected) in [
            (v1::FlowSource { state: String::new(), ..source() }, "source.state"),
            (v1::FlowSource { motion_state: String::new(), ..source() }, "source.motion_state"),
            (v1::FlowSource { motion_state: "people".to_owned(), ..source() }, "source.motion_state"),
            (v1::FlowSource { directions: 3, ..source() }, "source.directions"),
            (v1::FlowSource { resolution_m: -1.0, ..source() }, "source.resolution_m"),
            (v1::FlowSource { region: region(vec![0.0; 3], vec![1.0; 3]), ..source() }, "source.region.low_m"),
            (v1::FlowSource { region: region(vec![0.0; 2], vec![0.0; 2]), ..source() }, "source.region.high_m"),
        ] {
            assert_eq!(field(wrong), expected);
        }
        let nothing = v1::PredictFlowRequest { source: None, ..request(source()) };
        assert_eq!(flow_from_wire(nothing).expect_err("wrong").field, "source");
    }

    #[test]
    fn costs_of_encounters_need_people_to_avoid() {
        let avoid = |request: &v1::PlanRouteRequest| avoided_from_wire(request);
        let plain = v1::PlanRouteRequest::default();
        assert_eq!(avoid(&plain), Ok(None));
        let stray = v1::PlanRouteRequest { encounter_cost_secs: Some(3.0), ..plain.clone() };
        assert_eq!(avoid(&stray).expect_err("wrong").field, "encounter_cost_secs");
        let people = v1::PlanRouteRequest { avoid_people: Some(source()), ..plain };
        let found = avoid(&people).expect("right").expect("people");
        assert_eq!((found.encounter_cost_secs, found.near_m), (10.0, 1.0));
        let far = v1::PlanRouteRequest { near_m: 101.0, ..people };
        assert_eq!(avoid(&far).expect_err("wrong").field, "near_m");
    }

    #[test]
    fn cells_of_a_flow_have_a_share_per_direction() {
        let cell = |cell, per_sec: [f64; 2]| CellFlow { cell, per_sec: per_sec.to_vec() };
        let wire = flow_cells_to_wire(3, &[cell(5, [0.25, 0.75]), cell(8, [1.0, 1.0])], 10.0);
        assert_eq!((wire.time_index, wire.indices.as_slice()), (3, &[5, 8][..]));
        assert_eq!((wire.expected_counts, wire.shares), (vec![10.0, 20.0], vec![0.25, 0.75, 0.5, 0.5]));
    }
}
