//! Sightings: the landmarks of a place that a robot saw at a time, and those that it looked for in vain.
//!
//! Invariant: a sighting is an observation of each landmark of its place and part, 1 or 0, except the landmarks that
//! were out of view; it is accepted whole or not at all.

use std::collections::HashMap;

use tidemap_model::StateKind;

use crate::{
    landmark::{Landmark, LandmarkError},
    name::{PlaceName, StateName},
    report_sample::{ReportSample, traversal_samples},
    site::Site,
    topology::{LENGTH_MAX_M, TopologyError},
    traversal::{Traversal, TraversalError},
};

/// Why a sighting is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SightingError {
    /// It is too old.
    #[error("time {0} ns is before 1970")]
    Before1970(i64),
    /// The place or a landmark does not exist.
    #[error(transparent)]
    Landmark(#[from] LandmarkError),
    /// A landmark is named twice.
    #[error("landmark {0:?} is named twice: it is seen, or out of view, or was searched for and not seen")]
    NamedTwice(String),
    /// The part of the edge is invalid.
    #[error("part {from_m} m to {to_m} m: only an edge has parts, and they begin at 0 or later and end after that")]
    Part {
        /// The beginning of the part.
        from_m: f64,
        /// The end of the part.
        to_m: f64,
    },
    /// The traversal is of an edge that is not the place.
    #[error("the traversal is of edge {traversed:?}, and the sighting of {place:?}: both must be of one edge")]
    OtherEdge {
        /// The edge that was traversed.
        traversed: String,
        /// The place.
        place: String,
    },
    /// The robot looked before or after the traversal.
    #[error("time {time_nanos} ns is not within the traversal, from {start_nanos} ns to {end_nanos} ns")]
    NotOnTheWay {
        /// The time at which the robot looked, nanoseconds UTC.
        time_nanos: i64,
        /// When the traversal started, nanoseconds UTC.
        start_nanos: i64,
        /// When it ended, nanoseconds UTC.
        end_nanos: i64,
    },
    /// The traversal is invalid.
    #[error(transparent)]
    Traversal(#[from] TraversalError),
}

/// A part of an edge, metres from its beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartOfEdge {
    /// The beginning of the part, included.
    pub from_m: f64,
    /// The end of the part, included.
    pub to_m: f64,
}

impl PartOfEdge {
    /// The whole edge.
    pub const WHOLE: PartOfEdge = PartOfEdge { from_m: 0.0, to_m: LENGTH_MAX_M };

    /// Checks that a place may have this part.
    ///
    /// # Errors
    /// [`SightingError::Part`].
    pub fn check(self, place: &PlaceName) -> Result<(), SightingError> {
        let PartOfEdge { from_m, to_m } = self;
        let is_whole = self == PartOfEdge::WHOLE;
        let is_valid = is_whole || (matches!(place, PlaceName::Edge(_)) && from_m >= 0.0 && to_m >= from_m);
        if is_valid { Ok(()) } else { Err(SightingError::Part { from_m, to_m }) }
    }

    /// Whether a landmark is in this part; landmarks of nodes are in every part.
    #[must_use]
    pub fn holds(self, landmark: &Landmark) -> bool {
        landmark.kind.along_m().is_none_or(|along| (self.from_m..=self.to_m).contains(&along))
    }
}

/// The landmarks of a place that a robot saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// The place at which the robot looked.
    pub place: PlaceName,
    /// The part of the edge.
    pub part: PartOfEdge,
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// The landmarks that it saw.
    pub seen: Vec<StateName>,
    /// The landmarks that the robot could not have seen: hidden behind something, or beyond the edge of the image.
    pub out_of_view: Vec<StateName>,
    /// The traversal on which the robot looked, of the edge that is the place.
    pub traversal: Option<Traversal>,
}

impl Sighting {
    /// The observations that the sighting contains.
    ///
    /// # Errors
    /// [`SightingError`]; then there are no observations.
    pub fn samples(&self, site: &Site) -> Result<Vec<ReportSample>, SightingError> {
        let Self { place, part, time_nanos, seen, out_of_view, traversal } = self;
        if *time_nanos < 0 {
            return Err(SightingError::Before1970(*time_nanos));
        }
        part.check(place)?;
        let unknown_place = |error: TopologyError| SightingError::Landmark(error.into());
        let at = site.topology().place(place).map_err(unknown_place)?;
        let nothing = || LandmarkError::Nothing(place.to_string());
        let landmarks = site.landmarks().at(at).ok_or_else(nothing)?.landmarks();
        let mut named: HashMap<&str, Option<f64>> = HashMap::with_capacity(seen.len() + out_of_view.len());
        for (names, value) in [(seen, Some(1.0)), (out_of_view, None)] {
            for name in names {
                if named.insert(name.as_str(), value).is_some() {
                    return Err(SightingError::NamedTwice(name.to_string()));
                }
            }
        }
        let mut samples = Vec::with_capacity(landmarks.len() + 2);
        for landmark in landmarks {
            let value = named.remove(landmark.name.as_str());
            if !part.holds(landmark) && value.is_none() {
                continue;
            }
            if let Some(value) = value.unwrap_or(Some(0.0)) {
                let state = place.landmark(&landmark.name);
                samples.push(ReportSample { state, kind: StateKind::Probability, time_nanos: *time_nanos, value });
            }
        }
        let unknown = seen.iter().chain(out_of_view).find(|name| named.contains_key(name.as_str()));
        if let Some(name) = unknown {
            return Err(LandmarkError::unknown(place, name).into());
        }
        if let Some(traversal) = traversal {
            samples.extend(of_traversal(self, traversal, site)?);
        }
        Ok(samples)
    }
}

/// The observations of the traversal on which a robot looked.
fn of_traversal(
    Sighting { place, time_nanos, .. }: &Sighting,
    traversal: &Traversal,
    site: &Site,
) -> Result<Vec<ReportSample>, SightingError> {
    if *place != PlaceName::Edge(traversal.edge.clone()) {
        let (traversed, place) = (traversal.edge.to_string(), place.to_string());
        return Err(SightingError::OtherEdge { traversed, place });
    }
    let Traversal { start_nanos, end_nanos, .. } = *traversal;
    if !(start_nanos..=end_nanos).contains(time_nanos) {
        return Err(SightingError::NotOnTheWay { time_nanos: *time_nanos, start_nanos, end_nanos });
    }
    let edge = site.topology().edge_named(&traversal.edge).map_err(LandmarkError::from)?;
    Ok(traversal_samples(traversal, edge)?)
}

#[cfg(test)]
mod tests;
