//! Landmarks, and the places at which they are seen.
//!
//! Invariant: an error names the field of what is invalid; the map itself checks what depends on others.

use tidemap_map::{
    landmark::{Descriptor, DescriptorError, ImageFeature, Landmark, LandmarkEdit, LandmarkKind},
    landmark_forecast::PredictedLandmark,
    name::{PlaceName, StateName},
    sighting::PartOfEdge,
};
use tidemap_plan::localise::{NodeMatch, SeenFeatures};

use super::{
    InvalidField,
    grid::{pose_from_wire, pose_to_wire},
    time::instant_from_wire,
    topology::{edge_name_from_wire, edge_name_to_wire},
};
use crate::v1::{self, landmark::Kind, landmark_place::Place};

/// A place, and the part of it.
///
/// # Errors
/// It is missing, a name is invalid, or a node has a part.
pub fn place_from_wire(field: &str, wire: Option<&v1::LandmarkPlace>) -> Result<(PlaceName, PartOfEdge), InvalidField> {
    let missing = || InvalidField::new(field, "missing: name a node, or an edge");
    let v1::LandmarkPlace { place, from_m, to_m } = wire.ok_or_else(missing)?;
    let place = match place.as_ref().ok_or_else(missing)? {
        Place::Node(node) => {
            PlaceName::Node(StateName::new(node).map_err(|error| InvalidField::new(format!("{field}.node"), error))?)
        }
        Place::Edge(edge) => PlaceName::Edge(edge_name_from_wire(&format!("{field}.edge"), Some(edge))?),
    };
    let whole = PartOfEdge::WHOLE;
    let part = PartOfEdge { from_m: from_m.unwrap_or(whole.from_m), to_m: to_m.unwrap_or(whole.to_m) };
    part.check(&place).map_err(|error| InvalidField::new(field, error))?;
    Ok((place, part))
}

/// A whole place.
///
/// # Errors
/// The errors of [`place_from_wire`], or the place is a part of an edge.
pub fn whole_place_from_wire(field: &str, wire: Option<&v1::LandmarkPlace>) -> Result<PlaceName, InvalidField> {
    match place_from_wire(field, wire)? {
        (place, PartOfEdge::WHOLE) => Ok(place),
        _ => Err(InvalidField::new(field, "from_m and to_m have no meaning here: name the whole edge")),
    }
}

/// A place for the wire; the bounds of the whole edge are left out.
#[must_use]
pub fn place_to_wire(place: &PlaceName, part: PartOfEdge) -> v1::LandmarkPlace {
    let place = Some(match place {
        PlaceName::Node(node) => Place::Node(node.as_str().to_owned()),
        PlaceName::Edge(edge) => Place::Edge(edge_name_to_wire(edge)),
    });
    let given = |bound: f64, whole: f64| (bound.to_bits() != whole.to_bits()).then_some(bound);
    let PartOfEdge { from_m, to_m } = PartOfEdge::WHOLE;
    v1::LandmarkPlace { place, from_m: given(part.from_m, from_m), to_m: given(part.to_m, to_m) }
}

/// An image feature.
///
/// # Errors
/// [`DescriptorError`]
pub fn feature_from_wire(wire: &v1::ImageFeature) -> Result<ImageFeature, DescriptorError> {
    let v1::ImageFeature { u_px, v_px, descriptor } = wire;
    Ok(ImageFeature { u_px: *u_px, v_px: *v_px, descriptor: Descriptor::new(descriptor)? })
}

/// An image feature for the wire.
#[must_use]
pub fn feature_to_wire(feature: &ImageFeature) -> v1::ImageFeature {
    v1::ImageFeature { u_px: feature.u_px, v_px: feature.v_px, descriptor: feature.descriptor.to_bytes() }
}

/// A landmark.
///
/// # Errors
/// An invalid name, descriptor or pose, or no kind.
pub fn landmark_from_wire(field: &str, wire: &v1::Landmark) -> Result<Landmark, InvalidField> {
    let v1::Landmark { name, kind, covariance } = wire;
    let within = |part: &str| format!("{field}.{part}");
    let feature = |feature: &v1::ImageFeature| {
        feature_from_wire(feature).map_err(|error| InvalidField::new(within("descriptor"), error))
    };
    let missing = || InvalidField::new(field, "missing: set how it is recognised: by image, marker or path");
    let kind = match kind.as_ref().ok_or_else(missing)? {
        Kind::Image(image) => LandmarkKind::Image(feature(image)?),
        Kind::Marker(marker) => {
            let pose = Box::new(pose_from_wire(&within("marker.pose"), marker.pose)?);
            LandmarkKind::Marker { number: marker.number, pose }
        }
        Kind::Path(path) => {
            let missing = || InvalidField::new(within("path.feature"), "missing: set what the robot sees there");
            LandmarkKind::Path { along_m: path.along_m, feature: feature(path.feature.as_ref().ok_or_else(missing)?)? }
        }
    };
    let name = StateName::new(name).map_err(|error| InvalidField::new(within("name"), error))?;
    Ok(Landmark { name, kind, covariance: (!covariance.is_empty()).then(|| covariance.as_slice().into()) })
}

/// A landmark for the wire.
#[must_use]
pub fn landmark_to_wire(landmark: &Landmark) -> v1::Landmark {
    let kind = match &landmark.kind {
        LandmarkKind::Image(feature) => Kind::Image(feature_to_wire(feature)),
        LandmarkKind::Marker { number, pose } => {
            Kind::Marker(v1::Marker { number: *number, pose: Some(pose_to_wire(pose)) })
        }
        LandmarkKind::Path { along_m, feature } => {
            Kind::Path(v1::PathFeature { along_m: *along_m, feature: Some(feature_to_wire(feature)) })
        }
    };
    v1::Landmark {
        name: landmark.name.as_str().to_owned(),
        kind: Some(kind),
        covariance: landmark.covariance.as_deref().unwrap_or_default().to_vec(),
    }
}

/// Landmarks to add.
///
/// # Errors
/// An invalid place or landmark.
pub fn addition_from_wire(request: &v1::AddLandmarksRequest) -> Result<LandmarkEdit, InvalidField> {
    let v1::AddLandmarksRequest { place, landmarks, descriptor_kind, velocity_profile, .. } = request;
    let place = whole_place_from_wire("place", place.as_ref())?;
    let landmark = |(number, landmark)| landmark_from_wire(&format!("landmarks[{number}]"), landmark);
    let landmarks = landmarks.iter().enumerate().map(landmark).collect::<Result<Vec<_>, InvalidField>>()?;
    let velocity_profile = velocity_profile.clone().map(Vec::into_boxed_slice);
    Ok(LandmarkEdit::Add { place, descriptor_kind: descriptor_kind.clone(), landmarks, velocity_profile })
}

/// The landmarks to remove.
#[derive(Clone, Debug, PartialEq)]
pub enum LandmarkRemoval {
    /// The landmarks with these names at a place.
    Named(PlaceName, Vec<StateName>),
    /// The landmarks that are hardly ever seen.
    SeldomSeen {
        /// The place; `None`: everywhere.
        place: Option<PlaceName>,
        /// Landmarks with a lower share of sightings, in (0, 1].
        below: f64,
        /// Minimum number of sightings in which they were in view.
        min_sightings: u64,
    },
}

/// Default number of sightings from which on a landmark counts as seldom seen.
const MIN_SIGHTINGS: u64 = 10;

/// The landmarks to remove.
///
/// # Errors
/// An invalid place, name or share, or neither names nor a share.
pub fn removal_from_wire(request: &v1::RemoveLandmarksRequest) -> Result<LandmarkRemoval, InvalidField> {
    let v1::RemoveLandmarksRequest { place, names, seldom_seen, .. } = request;
    match (seldom_seen, names.is_empty()) {
        (Some(v1::SeldomSeen { below, min_sightings }), true) => {
            if !(*below > 0.0 && *below <= 1.0) {
                return Err(InvalidField::new(
                    "seldom_seen.below",
                    format!("{below}: it must be above 0 and at most 1"),
                ));
            }
            let place = place.as_ref().map(|place| whole_place_from_wire("place", Some(place))).transpose()?;
            let min_sightings = if *min_sightings == 0 { MIN_SIGHTINGS } else { *min_sightings };
            Ok(LandmarkRemoval::SeldomSeen { place, below: *below, min_sightings })
        }
        (None, false) => {
            let name = |(number, name): (usize, &String)| {
                StateName::new(name).map_err(|error| InvalidField::new(format!("names[{number}]"), error))
            };
            let names = names.iter().enumerate().map(name).collect::<Result<_, InvalidField>>()?;
            Ok(LandmarkRemoval::Named(whole_place_from_wire("place", place.as_ref())?, names))
        }
        _ => Err(InvalidField::new("names", "name landmarks, or set seldom_seen: one of the two")),
    }
}

/// The features that a robot sees, and the nodes at which it may be.
#[derive(Clone, Debug)]
pub struct LocaliseQuestion {
    /// When the image was taken, nanoseconds UTC.
    pub time_nanos: i64,
    /// The features of the image.
    pub seen: SeenFeatures,
    /// Maximum number of landmarks of each node to compare.
    pub per_node: usize,
    /// The nodes; empty: all with image features.
    pub nodes: Vec<PlaceName>,
}

/// Minimum number of features: the nearest is compared with the next.
const FEATURES_MIN: usize = 2;
/// Default number of landmarks of each node to compare.
const COMPARED: usize = 100;

/// Reads the question where a robot may be.
///
/// # Errors
/// No time, too few or invalid features, or an invalid name.
pub fn localise_from_wire(request: &v1::LocaliseRequest) -> Result<LocaliseQuestion, InvalidField> {
    let v1::LocaliseRequest { time, features, landmarks_per_node, nodes, .. } = request;
    if features.len() < FEATURES_MIN {
        let text = format!("{}: at least {FEATURES_MIN} features are needed, to find the nearest one", features.len());
        return Err(InvalidField::new("features", text));
    }
    let feature = |(number, wire): (usize, &v1::ImageFeature)| {
        let field = || format!("features[{number}]");
        let feature = feature_from_wire(wire).map_err(|error| InvalidField::new(field(), error))?;
        let is_place = feature.u_px.is_finite() && feature.v_px.is_finite();
        if is_place { Ok(feature) } else { Err(InvalidField::new(field(), "u_px and v_px must be numbers")) }
    };
    let features = features.iter().enumerate().map(feature).collect::<Result<Vec<_>, InvalidField>>()?;
    let node = |node: &String| StateName::new(node).map_err(|error| InvalidField::new("nodes", error));
    let mut named: Vec<&String> = nodes.iter().collect();
    named.sort_unstable();
    if let Some(twice) = named.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(InvalidField::new("nodes", format!("{:?} is named twice", twice[0])));
    }
    Ok(LocaliseQuestion {
        time_nanos: instant_from_wire("time", *time)?,
        seen: SeenFeatures::new(features).map_err(|error| InvalidField::new("features", error))?,
        per_node: if *landmarks_per_node == 0 { COMPARED } else { *landmarks_per_node as usize },
        nodes: nodes.iter().map(|name| node(name).map(PlaceName::Node)).collect::<Result<_, InvalidField>>()?,
    })
}

/// A number of landmarks for the wire.
#[must_use]
pub fn landmark_number_to_wire(landmarks: usize) -> u32 {
    u32::try_from(landmarks).unwrap_or(u32::MAX)
}

/// A landmark with the share of sightings in which it was seen, for the wire.
#[must_use]
pub fn known_landmark_to_wire(known: &PredictedLandmark<'_>) -> v1::KnownLandmark {
    v1::KnownLandmark {
        landmark: Some(landmark_to_wire(known.landmark)),
        seen_share: known.mean,
        sightings: known.sightings,
    }
}

/// A landmark with the probability that it is visible, for the wire.
#[must_use]
pub fn predicted_landmark_to_wire(known: &PredictedLandmark<'_>) -> v1::PredictedLandmark {
    v1::PredictedLandmark {
        landmark: Some(landmark_to_wire(known.landmark)),
        probability: known.probability,
        sightings: known.sightings,
    }
}

/// A place with the number of its landmarks, for the wire.
#[must_use]
pub fn landmark_count_to_wire(place: &PlaceName, landmarks: usize) -> v1::LandmarkCount {
    v1::LandmarkCount {
        place: Some(place_to_wire(place, PartOfEdge::WHOLE)),
        landmarks: landmark_number_to_wire(landmarks),
    }
}

/// The landmarks that are removed at a place, for the wire.
#[must_use]
pub fn removed_landmarks_to_wire(place: &PlaceName, names: &[StateName]) -> v1::RemovedLandmarks {
    v1::RemovedLandmarks {
        place: Some(place_to_wire(place, PartOfEdge::WHOLE)),
        names: names.iter().map(|name| name.as_str().to_owned()).collect(),
    }
}

/// How well an image agrees with a node, for the wire. `landmarks`: the number of landmarks that were compared.
#[must_use]
pub fn node_match_to_wire(node: String, landmarks: usize, found: &NodeMatch) -> v1::NodeMatch {
    v1::NodeMatch {
        node,
        landmarks: landmark_number_to_wire(landmarks),
        matches: found.matches,
        votes: found.votes,
        heading_px: found.heading_px,
        probability: found.probability,
    }
}
