//! Landmarks of nodes and edges: adding and removing them, which are visible when, and localisation of a robot by the
//! landmarks that it sees.
//!
//! Invariant: an edit is durable when its method returns.

pub use tidemap_map::{
    landmark::{Descriptor, ImageFeature, Landmark, LandmarkKind},
    name::PlaceName,
    sighting::PartOfEdge,
};
use tidemap_proto::{
    convert::{
        landmarks::{feature_to_wire, landmark_from_wire, landmark_to_wire, place_from_wire, place_to_wire},
        time::timestamp,
    },
    v1::{self, landmark_service_client::LandmarkServiceClient},
};

use crate::{
    connection::{Client, Connection},
    error::Error,
};

/// Maximum size of a reply: the landmarks of a place, or the places of a large map.
const LANDMARK_BYTES: usize = 16 << 20;

/// A landmark with its learned data.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownLandmark {
    /// The landmark.
    pub landmark: Landmark,
    /// Share of the learned sightings in which it was seen, 0 to 1; 0.5 without any.
    pub seen_share: f64,
    /// Number of sightings in which it was in view.
    pub sightings: u64,
}

/// A landmark at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkAtTime {
    /// The landmark.
    pub landmark: Landmark,
    /// Probability that it is visible, 0 to 1.
    pub probability: f64,
    /// Number of sightings in which it was in view.
    pub sightings: u64,
}

/// A selection of landmarks to remove.
#[derive(Clone, Debug, PartialEq)]
pub enum LandmarkSelection {
    /// The landmarks of these names at a place.
    Named(PlaceName, Vec<String>),
    /// The landmarks at a place, or everywhere, that are seen in less than a share of at least so many sightings.
    SeldomSeen {
        /// The place; `None`: everywhere.
        place: Option<PlaceName>,
        /// The share, above 0, at most 1.
        below: f64,
        /// The minimum number of sightings in which a landmark was in view; 0: 10.
        min_sightings: u64,
    },
}

/// A request for the places where a robot may be.
#[derive(Clone, Debug, PartialEq)]
pub struct LocaliseQuery {
    /// Name of the map.
    pub map: String,
    /// The time of the image, nanoseconds UTC.
    pub time_nanos: i64,
    /// The features of the image, 2 to 10,000.
    pub features: Vec<ImageFeature>,
    /// Maximum number of landmarks of each node to compare; 0: 100.
    pub landmarks_per_node: u32,
    /// The nodes at which the robot may be; empty: all with image features.
    pub nodes: Vec<String>,
}

/// The agreement of an image with a node.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundNode {
    /// Name of the node.
    pub node: String,
    /// Number of landmarks that were compared.
    pub landmarks: u32,
    /// Landmarks that have a clearly nearest feature.
    pub matches: u32,
    /// Matches that agree about the heading.
    pub votes: u32,
    /// The shift of the features to the right of the landmarks, pixels; `None`: no vote.
    pub heading_px: Option<f64>,
    /// Probability that the robot is there, if it is at one of the nodes.
    pub probability: f64,
}

impl Client {
    fn landmark_service(&self) -> LandmarkServiceClient<Connection> {
        LandmarkServiceClient::new(self.requests()).max_decoding_message_size(LANDMARK_BYTES)
    }

    /// Adds landmarks to a place, or replaces those with the same names. Returns the numbers of landmarks at the place
    /// and in the map. `descriptor_kind`: name of the algorithm that computes the descriptors. `velocity_profile`: of
    /// an edge, if given.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the place does not exist, and the message names an invalid landmark.
    pub async fn add_landmarks(
        &self,
        map: &str,
        place: &PlaceName,
        descriptor_kind: &str,
        landmarks: &[Landmark],
        velocity_profile: Option<&[u8]>,
    ) -> Result<(u32, u32), Error> {
        let request = v1::AddLandmarksRequest {
            map: map.to_owned(),
            place: Some(place_to_wire(place, PartOfEdge::WHOLE)),
            landmarks: landmarks.iter().map(landmark_to_wire).collect(),
            descriptor_kind: descriptor_kind.to_owned(),
            velocity_profile: velocity_profile.map(<[u8]>::to_vec),
        };
        let answer = self.landmark_service().add_landmarks(request).await.map_err(|status| self.error(&status))?;
        let v1::AddLandmarksResponse { at_place, in_map } = answer.into_inner();
        Ok((at_place, in_map))
    }

    /// The landmarks of a place or a part of an edge, with their learned data, and the velocity profile of the edge.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if map or place do not exist.
    pub async fn landmarks(
        &self,
        map: &str,
        place: &PlaceName,
        part: PartOfEdge,
    ) -> Result<(Vec<KnownLandmark>, Vec<u8>), Error> {
        let request = v1::ListLandmarksRequest { map: map.to_owned(), place: Some(place_to_wire(place, part)) };
        let answer = self.landmark_service().list_landmarks(request).await.map_err(|status| self.error(&status))?;
        let v1::ListLandmarksResponse { landmarks, velocity_profile, .. } = answer.into_inner();
        let known = |v1::KnownLandmark { landmark, seen_share, sightings }| {
            Ok(KnownLandmark { landmark: landmark_of(landmark)?, seen_share, sightings })
        };
        Ok((landmarks.into_iter().map(known).collect::<Result<_, Error>>()?, velocity_profile))
    }

    /// The places with landmarks, and the number of landmarks of each; and the name of the algorithm that computes the
    /// descriptors of the map.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn landmark_places(&self, map: &str) -> Result<(Vec<(PlaceName, u32)>, String), Error> {
        let request = v1::ListLandmarksRequest { map: map.to_owned(), place: None };
        let answer = self.landmark_service().list_landmarks(request).await.map_err(|status| self.error(&status))?;
        let v1::ListLandmarksResponse { places, descriptor_kind, .. } = answer.into_inner();
        let counted = |v1::LandmarkCount { place, landmarks }| Ok((place_of(place.as_ref())?, landmarks));
        Ok((places.into_iter().map(counted).collect::<Result<_, Error>>()?, descriptor_kind))
    }

    /// Removes landmarks, or with `is_dry_run` returns those that it would remove, by place.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if map, place or landmark do not exist.
    pub async fn remove_landmarks(
        &self,
        map: &str,
        selection: LandmarkSelection,
        is_dry_run: bool,
    ) -> Result<Vec<(PlaceName, Vec<String>)>, Error> {
        let (map, dry_run) = (map.to_owned(), is_dry_run);
        let wire = |place: &PlaceName| place_to_wire(place, PartOfEdge::WHOLE);
        let request = match selection {
            LandmarkSelection::Named(place, names) => {
                v1::RemoveLandmarksRequest { map, place: Some(wire(&place)), names, seldom_seen: None, dry_run }
            }
            LandmarkSelection::SeldomSeen { place, below, min_sightings } => v1::RemoveLandmarksRequest {
                map,
                place: place.as_ref().map(wire),
                names: Vec::new(),
                seldom_seen: Some(v1::SeldomSeen { below, min_sightings }),
                dry_run,
            },
        };
        let answer = self.landmark_service().remove_landmarks(request).await.map_err(|status| self.error(&status))?;
        let removed = |v1::RemovedLandmarks { place, names }| Ok((place_of(place.as_ref())?, names));
        answer.into_inner().removed.into_iter().map(removed).collect()
    }

    /// Predicts which landmarks of a part of a place are visible at a time, the most probable first; at most `limit`,
    /// or all if it is 0. Also gives the number of landmarks there.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if map or place do not exist.
    pub async fn predict_landmarks(
        &self,
        map: &str,
        (place, part): (&PlaceName, PartOfEdge),
        time_nanos: i64,
        limit: u32,
    ) -> Result<(Vec<LandmarkAtTime>, u32), Error> {
        let request = v1::PredictLandmarksRequest {
            map: map.to_owned(),
            place: Some(place_to_wire(place, part)),
            time: Some(timestamp(time_nanos)),
            limit,
        };
        let answer = self.landmark_service().predict_landmarks(request).await.map_err(|status| self.error(&status))?;
        let v1::PredictLandmarksResponse { landmarks, known } = answer.into_inner();
        let predicted = |v1::PredictedLandmark { landmark, probability, sightings }| {
            Ok(LandmarkAtTime { landmark: landmark_of(landmark)?, probability, sightings })
        };
        Ok((landmarks.into_iter().map(predicted).collect::<Result<_, Error>>()?, known))
    }

    /// Finds the node at which a robot is by the image features that it sees: the nodes, the best first.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the map has no image features at nodes.
    pub async fn localise(&self, query: LocaliseQuery) -> Result<Vec<FoundNode>, Error> {
        let LocaliseQuery { map, time_nanos, features, landmarks_per_node, nodes } = query;
        let features = features.iter().map(feature_to_wire).collect();
        let request =
            v1::LocaliseRequest { map, time: Some(timestamp(time_nanos)), features, landmarks_per_node, nodes };
        let answer = self.landmark_service().localise(request).await.map_err(|status| self.error(&status))?;
        let found = |v1::NodeMatch { node, landmarks, matches, votes, heading_px, probability }| FoundNode {
            node,
            landmarks,
            matches,
            votes,
            heading_px,
            probability,
        };
        Ok(answer.into_inner().nodes.into_iter().map(found).collect())
    }
}

fn landmark_of(wire: Option<v1::Landmark>) -> Result<Landmark, Error> {
    landmark_from_wire("landmark", &wire.unwrap_or_default()).map_err(|_| Error::Protocol("an invalid landmark"))
}

fn place_of(wire: Option<&v1::LandmarkPlace>) -> Result<PlaceName, Error> {
    place_from_wire("place", wire).map(|(place, _)| place).map_err(|_| Error::Protocol("an invalid place"))
}
