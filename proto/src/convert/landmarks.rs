//! Landmarks, and the places at which they are seen.
//!
//! Invariant: an error names the field of what is invalid; the map itself checks what depends on others.

use tidemap_map::{
    landmark::{Descriptor, DescriptorError, ImageFeature, Landmark, LandmarkKind},
    name::{PlaceName, StateName},
    sighting::PartOfEdge,
};
use tidemap_plan::localise::NodeMatch;

use super::{
    InvalidField,
    grid::{pose_from_wire, pose_to_wire},
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
/// As [`place_from_wire`], or it is a part.
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
    let of = |part: &str| format!("{field}.{part}");
    let feature = |feature: &v1::ImageFeature| {
        feature_from_wire(feature).map_err(|error| InvalidField::new(of("descriptor"), error))
    };
    let missing = || InvalidField::new(field, "missing: say how it is recognised, by image, marker or path");
    let kind = match kind.as_ref().ok_or_else(missing)? {
        Kind::Image(image) => LandmarkKind::Image(feature(image)?),
        Kind::Marker(marker) => {
            let pose = Box::new(pose_from_wire(&of("marker.pose"), marker.pose)?);
            LandmarkKind::Marker { number: marker.number, pose }
        }
        Kind::Path(path) => {
            let missing = || InvalidField::new(of("path.feature"), "missing: say what the robot sees there");
            LandmarkKind::Path { along_m: path.along_m, feature: feature(path.feature.as_ref().ok_or_else(missing)?)? }
        }
    };
    let name = StateName::new(name).map_err(|error| InvalidField::new(of("name"), error))?;
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

/// How an image agrees with a node, for the wire. `landmarks`: the number that were compared.
#[must_use]
pub fn node_match_to_wire(node: String, landmarks: usize, found: &NodeMatch) -> v1::NodeMatch {
    v1::NodeMatch {
        node,
        landmarks: u32::try_from(landmarks).unwrap_or(u32::MAX),
        matches: found.matches,
        votes: found.votes,
        heading_px: found.heading_px,
        probability: found.probability,
    }
}
