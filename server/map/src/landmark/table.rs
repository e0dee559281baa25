//! The landmarks of a map: the place at which each is seen, and how it is recognised. The state of a landmark learns
//! when it is visible (T-RO, section VII).
//!
//! Invariant: a landmark has one name among those of its place; image features have descriptors of one kind and length
//! in the whole map. The landmarks of a place keep their order: a replaced one stays where it was, new ones are last.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    sync::Arc,
};

use nalgebra::Isometry3;

use super::{
    DESCRIPTOR_KIND_CHARS_MAX, IMAGE_COVARIANCE, ImageFeature, LANDMARKS_AT_PLACE_MAX, LANDMARKS_MAX, PIXEL_MAX,
    POSE_COVARIANCE, PROFILE_BYTES_MAX, PROFILES_BYTES_MAX, error::LandmarkError,
};
use crate::{
    name::{PlaceName, StateName},
    topology::{EdgeId, LENGTH_MAX_M, NodeId, Topology, TopologyError},
};

/// The place from which landmarks are seen, valid for as long as its map exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum LandmarkPlace {
    /// From a node.
    Node(NodeId),
    /// Along an edge.
    Edge(EdgeId),
}

/// How a landmark is recognised.
#[derive(Clone, Debug, PartialEq)]
pub enum LandmarkKind {
    /// In an image, by its descriptor.
    Image(ImageFeature),
    /// By a number that is printed on it, such as a WhyCon or AprilTag number; with its pose in the map's frame,
    /// metres.
    Marker {
        /// The number.
        number: u64,
        /// The transform map_from_marker.
        pose: Box<Isometry3<f64>>,
    },
    /// In the image that a robot takes on its way along an edge, by its descriptor (teach and repeat).
    Path {
        /// The position of the robot along the edge, metres, at least 0.
        along_m: f64,
        /// The feature that it sees there.
        feature: ImageFeature,
    },
}

impl LandmarkKind {
    /// The image feature; `None` for a marker.
    #[must_use]
    pub fn feature(&self) -> Option<&ImageFeature> {
        match self {
            Self::Image(feature) | Self::Path { feature, .. } => Some(feature),
            Self::Marker { .. } => None,
        }
    }

    /// The position of the landmark along its edge, metres.
    #[must_use]
    pub fn along_m(&self) -> Option<f64> {
        if let Self::Path { along_m, .. } = self { Some(*along_m) } else { None }
    }
}

/// A landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark {
    /// Name, unique at its place.
    pub name: StateName,
    /// The way in which the landmark is recognised.
    pub kind: LandmarkKind,
    /// Covariance of the position or pose, if it is known: [`IMAGE_COVARIANCE`] or [`POSE_COVARIANCE`] numbers.
    pub covariance: Option<Box<[f64]>>,
}

/// The landmarks of a place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LandmarksAtPlace {
    landmarks: Vec<Landmark>,
    velocity_profile: Box<[u8]>,
}

impl LandmarksAtPlace {
    /// The landmarks, in the order in which they were added.
    #[must_use]
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// How a robot drove along the edge when it learned the landmarks, in the robot's own format; may be empty.
    #[must_use]
    pub fn velocity_profile(&self) -> &[u8] {
        &self.velocity_profile
    }

    fn is_empty(&self) -> bool {
        self.landmarks.is_empty() && self.velocity_profile.is_empty()
    }
}

/// The kind of the descriptors of a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DescriptorKind {
    /// Name of the detector and its training, such as `grief-256`.
    pub name: String,
    /// Bytes of each descriptor.
    pub bytes: usize,
}

/// A change of the landmarks of a place.
#[derive(Clone, Debug, PartialEq)]
pub enum LandmarkEdit {
    /// Landmarks are added, or replace those of their names.
    Add {
        /// Where they are seen.
        place: PlaceName,
        /// Name of the kind of the descriptors; may be empty without image features, and where the map has a kind.
        descriptor_kind: String,
        /// The landmarks.
        landmarks: Vec<Landmark>,
        /// The velocity profile of the edge; `None` keeps the existing one.
        velocity_profile: Option<Box<[u8]>>,
    },
    /// Landmarks are removed. Their learned data stays, and belongs to a landmark of that name that is added again.
    Remove {
        /// Where they are seen.
        place: PlaceName,
        /// Names of the landmarks.
        names: Vec<StateName>,
    },
}

/// The landmarks of a map. Cheap to copy: places are shared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Landmarks {
    places: BTreeMap<LandmarkPlace, Arc<LandmarksAtPlace>>,
    count: usize,
    descriptor_kind: Option<DescriptorKind>,
}

impl Landmarks {
    /// Number of landmarks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no landmarks.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The kind of all descriptors; `None` before the first.
    #[must_use]
    pub fn descriptor_kind(&self) -> Option<&DescriptorKind> {
        self.descriptor_kind.as_ref()
    }

    /// The places with landmarks, in the order of their numbers, nodes first.
    pub fn places(&self) -> impl ExactSizeIterator<Item = (LandmarkPlace, &Arc<LandmarksAtPlace>)> {
        self.places.iter().map(|(place, landmarks)| (*place, landmarks))
    }

    /// The landmarks of a place; `None` where there are none.
    #[must_use]
    pub fn at(&self, place: LandmarkPlace) -> Option<&Arc<LandmarksAtPlace>> {
        self.places.get(&place)
    }

    /// The landmarks after an edit.
    ///
    /// # Errors
    /// [`LandmarkError`], with what is wrong.
    pub(crate) fn edited(&self, topology: &Topology, edit: &LandmarkEdit) -> Result<Landmarks, LandmarkError> {
        let mut edited = self.clone();
        match edit {
            LandmarkEdit::Add { place, descriptor_kind, landmarks, velocity_profile } => {
                let at = topology.place(place)?;
                edited.descriptor_kind = self.kind_with(descriptor_kind, landmarks)?;
                landmarks.iter().try_for_each(|landmark| landmark.check(place))?;
                let known = Arc::make_mut(edited.places.entry(at).or_default());
                if let Some(profile) = velocity_profile {
                    check_profile(place, profile)?;
                    known.velocity_profile.clone_from(profile);
                    let bytes: usize = edited.places.values().map(|known| known.velocity_profile.len()).sum();
                    if bytes > PROFILES_BYTES_MAX {
                        return Err(LandmarkError::LongProfiles(bytes));
                    }
                }
                let known = Arc::make_mut(edited.places.entry(at).or_default());
                edited.count += add(known, landmarks, place)?;
                if edited.count > LANDMARKS_MAX {
                    return Err(LandmarkError::TooMany);
                }
                edited.places.retain(|_, known| !known.is_empty());
                if edited.is_empty() {
                    edited.descriptor_kind = None;
                }
            }
            LandmarkEdit::Remove { place, names } => {
                let at = topology.place(place)?;
                let known = self.places.get(&at).ok_or_else(|| LandmarkError::Nothing(place.to_string()))?;
                let there: HashSet<&str> = known.landmarks.iter().map(|landmark| landmark.name.as_str()).collect();
                if let Some(name) = names.iter().find(|name| !there.contains(name.as_str())) {
                    return Err(LandmarkError::unknown(place, name));
                }
                let gone: HashSet<&str> = names.iter().map(StateName::as_str).collect();
                let mut left = LandmarksAtPlace::clone(known);
                left.landmarks.retain(|landmark| !gone.contains(landmark.name.as_str()));
                edited.count -= known.landmarks.len() - left.landmarks.len();
                if left.is_empty() {
                    edited.places.remove(&at);
                } else {
                    edited.places.insert(at, Arc::new(left));
                }
                if edited.is_empty() {
                    edited.descriptor_kind = None;
                }
            }
        }
        Ok(edited)
    }

    /// The kind of descriptors after these are added.
    fn kind_with(&self, name: &str, landmarks: &[Landmark]) -> Result<Option<DescriptorKind>, LandmarkError> {
        let mut kind = self.descriptor_kind.clone();
        if let Some(known) = kind.as_ref().filter(|known| !name.is_empty() && known.name != name) {
            return Err(LandmarkError::OtherKind { known: known.name.clone(), given: name.to_owned() });
        }
        for feature in landmarks.iter().filter_map(|landmark| landmark.kind.feature()) {
            let found = feature.descriptor.len();
            match &kind {
                Some(known) if known.bytes == found => {}
                Some(known) => return Err(LandmarkError::OtherLength { expected: known.bytes, found }),
                None if name.is_empty() => return Err(LandmarkError::NoKind),
                None if name.chars().count() > DESCRIPTOR_KIND_CHARS_MAX => return Err(LandmarkError::LongKind),
                None => kind = Some(DescriptorKind { name: name.to_owned(), bytes: found }),
            }
        }
        Ok(kind)
    }

    /// Drops places that a topological map no longer has.
    pub(crate) fn keep_places_of(&mut self, topology: &Topology) {
        let has = |place: &LandmarkPlace| match *place {
            LandmarkPlace::Node(node) => topology.node(node).is_ok(),
            LandmarkPlace::Edge(edge) => topology.edge(edge).is_ok(),
        };
        self.places.retain(|place, landmarks| {
            let stays = has(place);
            self.count -= if stays { 0 } else { landmarks.landmarks.len() };
            stays
        });
        if self.is_empty() {
            self.descriptor_kind = None;
        }
    }

    /// The landmarks of stored parts: places, ascending, with the names that they have in the topological map.
    ///
    /// # Errors
    /// [`LandmarkError`] for parts that break a rule of the table.
    pub fn from_parts(
        topology: &Topology,
        descriptor_kind: Option<DescriptorKind>,
        parts: Vec<(LandmarkPlace, Vec<Landmark>, Box<[u8]>)>,
    ) -> Result<Landmarks, LandmarkError> {
        let mut whole = Landmarks { descriptor_kind, ..Landmarks::default() };
        for (at, landmarks, velocity_profile) in parts {
            let place = topology.place_name(at)?;
            whole.kind_with("", &landmarks)?;
            landmarks.iter().try_for_each(|landmark| landmark.check(&place))?;
            check_profile(&place, &velocity_profile)?;
            let mut known = LandmarksAtPlace { landmarks: Vec::new(), velocity_profile };
            whole.count += add(&mut known, &landmarks, &place)?;
            if known.is_empty() || whole.places.insert(at, Arc::new(known)).is_some() {
                return Err(LandmarkError::Nothing(place.to_string()));
            }
        }
        Ok(whole)
    }
}

impl Topology {
    /// The place of a name.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNode`], [`TopologyError::UnknownEdge`].
    pub fn place(&self, name: &PlaceName) -> Result<LandmarkPlace, TopologyError> {
        Ok(match name {
            PlaceName::Node(node) => LandmarkPlace::Node(self.node_named(node.as_str())?.id),
            PlaceName::Edge(edge) => LandmarkPlace::Edge(self.edge_named(edge)?.id),
        })
    }

    /// The name of a place.
    ///
    /// # Errors
    /// [`TopologyError::UnknownNodeId`], [`TopologyError::UnknownEdgeId`].
    pub fn place_name(&self, place: LandmarkPlace) -> Result<PlaceName, TopologyError> {
        Ok(match place {
            LandmarkPlace::Node(node) => PlaceName::Node(self.node(node)?.name.clone()),
            LandmarkPlace::Edge(edge) => PlaceName::Edge(self.edge_in_words(self.edge(edge)?)?),
        })
    }
}

impl Landmark {
    fn check(&self, place: &PlaceName) -> Result<(), LandmarkError> {
        let name = || self.name.to_string();
        let is_edge = matches!(place, PlaceName::Edge(_));
        if self.kind.along_m().is_some() != is_edge {
            return Err(LandmarkError::KindOfPlace { name: name(), place: place.to_string() });
        }
        let place_in_image = self.kind.feature().map_or([0.0; 2], |feature| [feature.u_px, feature.v_px]);
        if let Some(found) = place_in_image.into_iter().find(|along| !(-PIXEL_MAX..=PIXEL_MAX).contains(along)) {
            return Err(LandmarkError::Pixel { name: name(), found });
        }
        if let Some(found) = self.kind.along_m().filter(|along| !(0.0..=LENGTH_MAX_M).contains(along)) {
            return Err(LandmarkError::Along { name: name(), found });
        }
        let Some(covariance) = &self.covariance else { return Ok(()) };
        let expected = if self.kind.feature().is_some() { IMAGE_COVARIANCE } else { POSE_COVARIANCE };
        let is_valid = covariance.len() == expected && covariance.iter().all(|number| number.is_finite());
        if is_valid { Ok(()) } else { Err(LandmarkError::Covariance { name: name(), expected }) }
    }
}

fn check_profile(place: &PlaceName, profile: &[u8]) -> Result<(), LandmarkError> {
    match place {
        PlaceName::Node(node) if !profile.is_empty() => Err(LandmarkError::ProfileOfNode(node.to_string())),
        _ if profile.len() > PROFILE_BYTES_MAX => Err(LandmarkError::LongProfile(profile.len())),
        _ => Ok(()),
    }
}

/// Adds or replaces landmarks. Returns by how many their number has grown.
fn add(known: &mut LandmarksAtPlace, landmarks: &[Landmark], place: &PlaceName) -> Result<usize, LandmarkError> {
    let before = known.landmarks.len();
    let mut by_name: HashMap<StateName, usize> =
        known.landmarks.iter().enumerate().map(|(at, landmark)| (landmark.name.clone(), at)).collect();
    let mut named = HashSet::new();
    for landmark in landmarks {
        if !named.insert(&landmark.name) {
            return Err(LandmarkError::Twice(landmark.name.to_string()));
        }
        match by_name.get(&landmark.name) {
            Some(&at) => known.landmarks[at] = landmark.clone(),
            None => {
                by_name.insert(landmark.name.clone(), known.landmarks.len());
                known.landmarks.push(landmark.clone());
            }
        }
    }
    if known.landmarks.len() > LANDMARKS_AT_PLACE_MAX {
        return Err(LandmarkError::TooManyAt(place.to_string()));
    }
    Ok(known.landmarks.len() - before)
}
