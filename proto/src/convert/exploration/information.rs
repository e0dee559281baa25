//! Information of states, locations, regions and views: questions and replies; and reports of visits.
//!
//! Invariant: checks here need no map; the handler of the request checks whether the map has the named objects.

use std::fmt::Display;

use tidemap_grid::index::CellBox;
use tidemap_map::{
    name::StateName,
    reachability::{Attempts, ReachabilityCell, ReachabilityRate},
};
use tidemap_model::selector::ModelSelector;
use tidemap_plan::{
    information::Certainty,
    view::{SceneOptions, Sensor, Viewpoint},
};

use super::{certainty_from_wire, scene_from_wire, sensor_from_wire, viewpoint_from_wire};
use crate::{
    convert::{
        InvalidField,
        grid::cell_box_from_wire,
        query::{check_for_cells, selector_from_wire},
        site::{location_names_from_wire, point_from_wire, point_to_wire},
        time::{nanos_from_timestamp, times_from_wire, timestamp},
    },
    v1,
};

/// The targets whose information is requested.
#[derive(Clone, Debug, PartialEq)]
pub enum InformationTargets {
    /// All observed cells of a region together.
    Region(CellBox),
    /// Each of these states, cells and locations.
    Named {
        /// Names of states and cells.
        states: Vec<String>,
        /// Names of locations.
        locations: Vec<StateName>,
    },
}

/// The question of a request for information.
#[derive(Clone, Debug, PartialEq)]
pub struct InformationQuestion {
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// The model; one that cells have, if a region is requested.
    pub selector: ModelSelector,
    /// The certainty after an observation.
    pub certainty: Certainty,
    /// The targets, at least one.
    pub targets: InformationTargets,
}

/// The question of a request for information.
///
/// # Errors
/// The invalid field.
pub fn information_from_wire(request: v1::GetInformationRequest) -> Result<InformationQuestion, InvalidField> {
    let v1::GetInformationRequest { times_nanos, states, locations, region, model, certainty, .. } = request;
    times_from_wire("times_nanos", &times_nanos)?;
    let selector = selector_from_wire("model", model)?;
    let certainty = certainty_from_wire("certainty", certainty)?;
    let has_names = !(states.is_empty() && locations.is_empty());
    let targets = match region {
        None if !has_names => return Err(InvalidField::new("states", "name a state, a location or a region")),
        None => {
            let locations = location_names_from_wire("locations", &locations)?;
            InformationTargets::Named { states, locations }
        }
        Some(_) if has_names => {
            return Err(InvalidField::new("region", "request a region in a separate request"));
        }
        Some(region) => {
            check_for_cells("model", selector)?;
            InformationTargets::Region(cell_box_from_wire(&region))
        }
    };
    Ok(InformationQuestion { times_nanos, selector, certainty, targets })
}

/// The information of a target at the times of a question.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetInformation {
    /// Name of the state, cell or location; `region` for a region.
    pub target: String,
    /// The entropy in bits, one per time.
    pub entropy_bits: Vec<f64>,
    /// The expected information of an observation in bits, one per time.
    pub information_bits: Vec<f64>,
    /// Number of states and cells that the target has.
    pub states: u64,
}

/// The information of a target for the wire.
#[must_use]
pub fn information_to_wire(information: TargetInformation) -> v1::GetInformationResponse {
    let TargetInformation { target, entropy_bits, information_bits, states } = information;
    v1::GetInformationResponse { target, entropy_bits, information_bits, states }
}

/// The question of a request for views.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewsQuestion {
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// A model that cells have.
    pub selector: ModelSelector,
    /// The viewpoints, at least one.
    pub viewpoints: Vec<Viewpoint>,
    /// How views are computed from predictions.
    pub scene: SceneOptions,
    /// The sensor of the robot.
    pub sensor: Sensor,
}

/// The question of a request for views.
///
/// # Errors
/// The invalid field.
pub fn views_from_wire(request: v1::EvaluateViewsRequest) -> Result<ViewsQuestion, InvalidField> {
    let v1::EvaluateViewsRequest { times_nanos, model, viewpoints, certainty, threshold, sensor, .. } = request;
    times_from_wire("times_nanos", &times_nanos)?;
    let selector = selector_from_wire("model", model)?;
    check_for_cells("model", selector)?;
    if viewpoints.is_empty() {
        return Err(InvalidField::new("viewpoints", "name at least one"));
    }
    Ok(ViewsQuestion {
        times_nanos,
        selector,
        viewpoints: viewpoints.iter().map(viewpoint_from_wire).collect(),
        scene: scene_from_wire(certainty, threshold)?,
        sensor: sensor_from_wire(sensor),
    })
}

/// The expected information of the viewpoint with this number for the wire, in bits, one per time; NaN where the
/// viewpoint has none. An error is the reason why the viewpoint is unusable.
#[must_use]
pub fn view_to_wire(number: usize, seen: Result<Vec<Option<f64>>, impl Display>) -> v1::EvaluateViewsResponse {
    let (information_bits, reason) = match seen {
        Ok(bits) => (bits.into_iter().map(|bits| bits.unwrap_or(f64::NAN)).collect(), String::new()),
        Err(error) => (Vec::new(), error.to_string()),
    };
    v1::EvaluateViewsResponse { viewpoint: u32::try_from(number).unwrap_or(u32::MAX), information_bits, reason }
}

/// A report of where a robot was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisitReport {
    /// Goal of the robot: x, y in metres.
    pub at_m: [f64; 2],
    /// Whether the robot arrived.
    pub reached: bool,
    /// When, nanoseconds UTC; `None`: now.
    pub utc_nanos: Option<i64>,
}

/// The report of a visit.
///
/// # Errors
/// The invalid field.
pub fn visit_from_wire(request: &v1::ReportVisitRequest) -> Result<VisitReport, InvalidField> {
    let missing = || InvalidField::new("at", "missing: give the position that the robot was sent to");
    let at_m = point_from_wire("at", request.at.ok_or_else(missing)?)?;
    let utc_nanos = request.time.map(|time| nanos_from_timestamp("time", time)).transpose()?;
    Ok(VisitReport { at_m, reached: request.reached, utc_nanos })
}

/// The probability of reaching a place for the wire, with the number of attempts that count.
#[must_use]
pub fn reachability_to_wire(rate: ReachabilityRate) -> v1::ReportVisitResponse {
    v1::ReportVisitResponse { reachability: rate.rate, attempts: rate.attempts.into() }
}

/// The places of a reply.
#[must_use]
pub fn reached_places_to_wire(places: &[(ReachabilityCell, Attempts)]) -> v1::ListReachabilityResponse {
    let place = |(cell, attempts): &(ReachabilityCell, Attempts)| v1::ReachedPlace {
        at: Some(point_to_wire(cell.centre_m())),
        reachability: attempts.rate(),
        attempts: attempts.count.into(),
        last_time: Some(timestamp(attempts.last_nanos)),
    };
    v1::ListReachabilityResponse { places: places.iter().map(place).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> v1::GetInformationRequest {
        v1::GetInformationRequest { times_nanos: vec![5], ..v1::GetInformationRequest::default() }
    }

    #[test]
    fn information_is_asked_of_names_or_of_a_region() {
        let field = |request| information_from_wire(request).expect_err("wrong").field;
        assert_eq!(field(request()), "states");
        let (states, region) = (vec!["door".to_owned()], Some(v1::CellBox::default()));
        assert_eq!(field(v1::GetInformationRequest { states: states.clone(), region, ..request() }), "region");
        let model = Some(v1::ModelSelector { kind: v1::ModelKind::Poisson.into(), ..v1::ModelSelector::default() });
        assert_eq!(field(v1::GetInformationRequest { region, model, ..request() }), "model.kind");
        let locations = vec!["hall".to_owned(), "a/b".to_owned()];
        assert_eq!(field(v1::GetInformationRequest { locations, ..request() }), "locations[1]");
        let question = information_from_wire(v1::GetInformationRequest { states: states.clone(), ..request() });
        let targets = InformationTargets::Named { states, locations: Vec::new() };
        assert_eq!(question.map(|question| question.targets), Ok(targets));
    }

    #[test]
    fn a_view_needs_a_viewpoint_and_a_visit_a_position() {
        let request = v1::EvaluateViewsRequest { times_nanos: vec![5], ..v1::EvaluateViewsRequest::default() };
        assert_eq!(views_from_wire(request).expect_err("wrong").field, "viewpoints");
        assert_eq!(visit_from_wire(&v1::ReportVisitRequest::default()).expect_err("wrong").field, "at");
    }

    #[test]
    fn a_viewpoint_has_numbers_or_the_reason_why_it_has_none() {
        let seen = view_to_wire(2, Ok::<_, String>(vec![Some(1.5), None]));
        assert_eq!((seen.viewpoint, seen.reason.as_str(), seen.information_bits[0]), (2, "", 1.5));
        assert!(seen.information_bits.len() == 2 && seen.information_bits[1].is_nan());
        let unusable = view_to_wire(3, Err("it is in a wall"));
        assert_eq!((unusable.reason.as_str(), unusable.information_bits.len()), ("it is in a wall", 0));
    }
}
