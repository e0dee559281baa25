//! Why landmarks are refused.
//!
//! Invariant: a message states what is wrong, with the value, and what would be right.

use super::{
    DESCRIPTOR_KIND_CHARS_MAX, LANDMARKS_AT_PLACE_MAX, LANDMARKS_MAX, PIXEL_MAX, PROFILE_BYTES_MAX, PROFILES_BYTES_MAX,
};
use crate::{
    name::{PlaceName, StateName},
    topology::TopologyError,
};

/// Why an edit of the landmarks is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LandmarkError {
    /// The place does not exist.
    #[error(transparent)]
    Place(#[from] TopologyError),
    /// A name is given twice.
    #[error("landmark {0:?} is given twice")]
    Twice(String),
    /// A landmark does not exist.
    #[error("{place:?} has no landmark {name:?}")]
    Unknown {
        /// The place.
        place: String,
        /// The landmark.
        name: String,
    },
    /// The place has no landmarks.
    #[error("{0:?} has no landmarks")]
    Nothing(String),
    /// Path features belong to edges, all others to nodes.
    #[error(
        "landmark {name:?} at {place:?}: a landmark of an edge has along_m, how far along the edge it is seen, and no \
         other landmark has it"
    )]
    KindOfPlace {
        /// The landmark.
        name: String,
        /// The place.
        place: String,
    },
    /// The position in the image is invalid.
    #[error("landmark {name:?} is at {found} px: it must be a number within ±{PIXEL_MAX}")]
    Pixel {
        /// The landmark.
        name: String,
        /// The value given.
        found: f64,
    },
    /// The position along the edge is invalid.
    #[error("landmark {name:?} is {found} m along its edge: it must be 0 to 1e7")]
    Along {
        /// The landmark.
        name: String,
        /// The value given.
        found: f64,
    },
    /// The covariance is invalid.
    #[error("the covariance of landmark {name:?} must have {expected} finite numbers")]
    Covariance {
        /// The landmark.
        name: String,
        /// The number of numbers.
        expected: usize,
    },
    /// Descriptors of two kinds cannot be compared.
    #[error("the map's descriptors are {known:?}, not {given:?}: descriptors of one map are of one kind")]
    OtherKind {
        /// The kind of the map.
        known: String,
        /// The kind given.
        given: String,
    },
    /// Descriptors of two lengths cannot be compared.
    #[error("a descriptor has {found} bytes, and those of the map have {expected}")]
    OtherLength {
        /// The number of bytes of the map's descriptors.
        expected: usize,
        /// The number of bytes given.
        found: usize,
    },
    /// The first descriptors need the name of their kind.
    #[error("descriptor_kind is missing: name what computes the descriptors, such as \"orb\" or \"grief-256\"")]
    NoKind,
    /// The name is too long.
    #[error("descriptor_kind has more than {DESCRIPTOR_KIND_CHARS_MAX} characters")]
    LongKind,
    /// Only edges have velocity profiles.
    #[error("node {0:?} cannot have a velocity profile: an edge has")]
    ProfileOfNode(String),
    /// The velocity profile is too long.
    #[error("a velocity profile of {0} bytes: at most {PROFILE_BYTES_MAX}")]
    LongProfile(usize),
    /// The velocity profiles of all edges are too long.
    #[error("the map's velocity profiles would have {0} bytes: at most {PROFILES_BYTES_MAX}")]
    LongProfiles(usize),
    /// There are too many landmarks at one place.
    #[error("{0:?} would have more than {LANDMARKS_AT_PLACE_MAX} landmarks")]
    TooManyAt(String),
    /// There are too many landmarks.
    #[error("the map would have more than {LANDMARKS_MAX} landmarks")]
    TooMany,
}

impl LandmarkError {
    pub(crate) fn unknown(place: &PlaceName, name: &StateName) -> LandmarkError {
        LandmarkError::Unknown { place: place.to_string(), name: name.to_string() }
    }
}
