//! The landmarks of nodes and edges.
//!
//! Invariant: the invariant of [`super::site`] holds here too.

/// A landmark.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Landmark {
    #[prost(string, tag = "1")]
    pub name: String,
    /// Position and descriptor in the image; absent for a marker.
    #[prost(message, optional, tag = "2")]
    pub feature: Option<ImageFeature>,
    /// Distance along the edge, bits of f64; absent at a node.
    #[prost(fixed64, optional, tag = "3")]
    pub along_bits: Option<u64>,
    /// The marker; absent for an image feature.
    #[prost(message, optional, tag = "4")]
    pub marker: Option<Marker>,
    /// Covariance of the position or pose, bits of f64; empty if it is not known.
    #[prost(fixed64, repeated, tag = "5")]
    pub covariance_bits: Vec<u64>,
}

/// An image feature.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ImageFeature {
    #[prost(fixed64, tag = "1")]
    pub u_bits: u64,
    #[prost(fixed64, tag = "2")]
    pub v_bits: u64,
    #[prost(bytes = "vec", tag = "3")]
    pub descriptor: Vec<u8>,
}

/// A marker.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Marker {
    #[prost(uint64, tag = "1")]
    pub number: u64,
    /// x, y, z in metres, and x, y, z, w of the unit quaternion; bits of f64.
    #[prost(fixed64, repeated, tag = "2")]
    pub pose_bits: Vec<u64>,
}

/// The landmarks of a node or an edge.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LandmarksAtPlace {
    /// Number of the node; absent for an edge.
    #[prost(uint32, optional, tag = "1")]
    pub node: Option<u32>,
    /// Number of the edge; absent for a node.
    #[prost(uint32, optional, tag = "2")]
    pub edge: Option<u32>,
    /// The landmarks, in the order in which they were added.
    #[prost(message, repeated, tag = "3")]
    pub landmarks: Vec<Landmark>,
    /// Velocity profile with which a robot drove along the edge, in the robot's own format.
    #[prost(bytes = "vec", tag = "4")]
    pub velocity_profile: Vec<u8>,
    /// Name of the kind of all descriptors of the map.
    #[prost(string, tag = "5")]
    pub descriptor_kind: String,
    /// Number of bytes of each descriptor; 0 if the map never had a descriptor.
    #[prost(uint32, tag = "6")]
    pub descriptor_bytes: u32,
}

/// A change of the landmarks of a place.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LandmarkEdit {
    /// `N`, `A/B` or `A/B/ACTION`.
    #[prost(string, tag = "1")]
    pub place: String,
    /// Kind of the descriptors; empty: the kind of the map.
    #[prost(string, tag = "2")]
    pub descriptor_kind: String,
    /// Landmarks that are added, or replace the landmarks with the same names.
    #[prost(message, repeated, tag = "3")]
    pub added: Vec<Landmark>,
    /// The profile that replaces the profile of the edge; absent: the profile stays.
    #[prost(bytes = "vec", optional, tag = "4")]
    pub velocity_profile: Option<Vec<u8>>,
    /// Names of landmarks that are removed; empty: the edit adds landmarks.
    #[prost(string, repeated, tag = "5")]
    pub removed: Vec<String>,
}
