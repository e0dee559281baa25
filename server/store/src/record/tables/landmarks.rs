//! Landmarks on the disk: a row for each node and edge that has landmarks, in the order of nodes and edges.
//!
//! Invariant: written data is read back bit by bit.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tidemap_layout::landmark as layout;
use tidemap_map::{
    landmark::{
        Descriptor, DescriptorKind, ImageFeature, Landmark, LandmarkEdit, LandmarkKind, LandmarkPlace, Landmarks,
        LandmarksAtPlace,
    },
    name::PlaceName,
    site::{Site, SiteEdit},
    topology::{EdgeId, NodeId},
};

use super::StoredTable;
use crate::record::{Invalid, ids::decode_state_name};

fn encode_feature(feature: &ImageFeature) -> layout::ImageFeature {
    layout::ImageFeature {
        u_bits: feature.u_px.to_bits(),
        v_bits: feature.v_px.to_bits(),
        descriptor: feature.descriptor.to_bytes(),
    }
}

fn decode_feature(message: &layout::ImageFeature) -> Result<ImageFeature, Invalid> {
    let descriptor = Descriptor::new(&message.descriptor).map_err(|_| "a descriptor has no valid length")?;
    let [u_px, v_px] = [message.u_bits, message.v_bits].map(f64::from_bits);
    Ok(ImageFeature { u_px, v_px, descriptor })
}

fn encode_pose(pose: &Isometry3<f64>) -> Vec<u64> {
    let [position, turn] = [pose.translation.vector.as_slice(), pose.rotation.coords.as_slice()];
    position.iter().chain(turn).map(|number| number.to_bits()).collect()
}

fn decode_pose(bits: &[u64]) -> Result<Isometry3<f64>, Invalid> {
    let bits: [u64; 7] = bits.try_into().map_err(|_| "a pose has not seven numbers")?;
    let [x, y, z, i, j, k, w] = bits.map(f64::from_bits);
    // The stored quaternion is a unit quaternion. Normalising it again would change it by rounding.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn encode_landmark(Landmark { name, kind, covariance }: &Landmark) -> layout::Landmark {
    let covariance = covariance.as_deref().unwrap_or_default();
    let marker = match kind {
        LandmarkKind::Marker { number, pose } => Some(layout::Marker { number: *number, pose_bits: encode_pose(pose) }),
        LandmarkKind::Image(_) | LandmarkKind::Path { .. } => None,
    };
    layout::Landmark {
        name: name.as_str().to_owned(),
        feature: kind.feature().map(encode_feature),
        along_bits: kind.along_m().map(f64::to_bits),
        marker,
        covariance_bits: covariance.iter().map(|number| number.to_bits()).collect(),
    }
}

fn decode_landmark(message: &layout::Landmark) -> Result<Landmark, Invalid> {
    let layout::Landmark { name, feature, along_bits, marker, covariance_bits } = message;
    let kind = match (feature, along_bits, marker) {
        (Some(feature), None, None) => LandmarkKind::Image(decode_feature(feature)?),
        (Some(feature), Some(along), None) => {
            LandmarkKind::Path { along_m: f64::from_bits(*along), feature: decode_feature(feature)? }
        }
        (None, None, Some(marker)) => {
            LandmarkKind::Marker { number: marker.number, pose: Box::new(decode_pose(&marker.pose_bits)?) }
        }
        _ => return Err("a landmark is of no kind"),
    };
    let covariance: Box<[f64]> = covariance_bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    Ok(Landmark { name: decode_state_name(name)?, kind, covariance: (!covariance.is_empty()).then_some(covariance) })
}

fn decode_landmarks(messages: &[layout::Landmark]) -> Result<Vec<Landmark>, Invalid> {
    messages.iter().map(decode_landmark).collect()
}

fn encode_place(
    place: LandmarkPlace,
    known: &LandmarksAtPlace,
    kind: Option<&DescriptorKind>,
) -> layout::LandmarksAtPlace {
    let (node, edge) = match place {
        LandmarkPlace::Node(NodeId(node)) => (Some(node), None),
        LandmarkPlace::Edge(EdgeId(edge)) => (None, Some(edge)),
    };
    layout::LandmarksAtPlace {
        node,
        edge,
        landmarks: known.landmarks().iter().map(encode_landmark).collect(),
        velocity_profile: known.velocity_profile().to_vec(),
        descriptor_kind: kind.map_or_else(String::new, |kind| kind.name.clone()),
        // At most 64.
        descriptor_bytes: kind.map_or(0, |kind| kind.bytes as u32),
    }
}

fn encode_change(edit: &LandmarkEdit) -> layout::LandmarkEdit {
    match edit {
        LandmarkEdit::Add { place, descriptor_kind, landmarks, velocity_profile } => layout::LandmarkEdit {
            place: place.to_string(),
            descriptor_kind: descriptor_kind.clone(),
            added: landmarks.iter().map(encode_landmark).collect(),
            velocity_profile: velocity_profile.as_deref().map(<[u8]>::to_vec),
            removed: Vec::new(),
        },
        LandmarkEdit::Remove { place, names } => layout::LandmarkEdit {
            place: place.to_string(),
            removed: names.iter().map(|name| name.as_str().to_owned()).collect(),
            ..layout::LandmarkEdit::default()
        },
    }
}

fn decode_change(message: &layout::LandmarkEdit) -> Result<LandmarkEdit, Invalid> {
    let place = PlaceName::parse(&message.place).map_err(|_| "the place of landmarks is not valid")?;
    if !message.removed.is_empty() {
        let names = message.removed.iter().map(|name| decode_state_name(name)).collect::<Result<_, _>>()?;
        return Ok(LandmarkEdit::Remove { place, names });
    }
    Ok(LandmarkEdit::Add {
        place,
        descriptor_kind: message.descriptor_kind.clone(),
        landmarks: decode_landmarks(&message.added)?,
        velocity_profile: message.velocity_profile.clone().map(Vec::into_boxed_slice),
    })
}

pub(super) enum LandmarkPlaces {}

impl StoredTable for LandmarkPlaces {
    const NUMBER: u32 = 8;
    type Row = layout::LandmarksAtPlace;
    type Edit = layout::LandmarkEdit;

    fn count(site: &Site) -> usize {
        site.landmarks().places().len()
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::LandmarksAtPlace> {
        let kind = site.landmarks().descriptor_kind();
        site.landmarks().places().map(move |(place, known)| encode_place(place, known, kind))
    }

    fn restore(site: Site, rows: Vec<layout::LandmarksAtPlace>, _: usize) -> Result<Site, String> {
        let Some(first) = rows.first() else { return Ok(site) };
        let bytes = first.descriptor_bytes as usize;
        let kind = (bytes > 0).then(|| DescriptorKind { name: first.descriptor_kind.clone(), bytes });
        let part = |row: &layout::LandmarksAtPlace| {
            let place = match (row.node, row.edge) {
                (Some(node), None) => LandmarkPlace::Node(NodeId(node)),
                (None, Some(edge)) => LandmarkPlace::Edge(EdgeId(edge)),
                _ => return Err("landmarks are of no place"),
            };
            Ok((place, decode_landmarks(&row.landmarks)?, row.velocity_profile.clone().into()))
        };
        let parts = rows.iter().map(part).collect::<Result<Vec<_>, Invalid>>()?;
        let landmarks = Landmarks::from_parts(site.topology(), kind, parts).map_err(|error| error.to_string())?;
        Ok(site.with_landmarks(landmarks))
    }

    fn encode_edit(edit: &SiteEdit) -> Option<layout::LandmarkEdit> {
        if let SiteEdit::Landmarks(edit) = edit { Some(encode_change(edit)) } else { None }
    }

    fn decode_edit(edit: layout::LandmarkEdit) -> Result<SiteEdit, Invalid> {
        Ok(SiteEdit::Landmarks(decode_change(&edit)?))
    }
}
