//! The mapping: the user's choice of the observations to make of the topics of a recording, as a YAML file.
//!
//! Invariant: a mapping that was read has possible paths, names and kinds; whether a recording has its topics and
//! fields is checked when a plan is made.

mod rule;

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::survey::PoseSource;

pub(crate) use self::rule::shown;
pub use self::rule::{FieldPlace, PositionRule, Reports, StateRule, Template, TraversalRule, ValueKind, ValueRule};

/// A hundred years are longer than any recording.
const GAP_SECS_MAX: f64 = 3.2e9;

/// The observations to make of a recording's topics, in addition to or instead of the default ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mapping {
    /// Topics that are left out.
    pub skip: Vec<String>,
    /// Topics of scans, clouds and grids that are taken even where they would be left out.
    pub grid: Vec<String>,
    /// Observations of states.
    pub states: Vec<StateRule>,
    /// Observations of positions.
    pub positions: Vec<PositionRule>,
    /// Traversals of edges.
    pub traversals: Vec<TraversalRule>,
    /// The longest time between two transforms that differ, nanoseconds.
    pub transform_gap_nanos: Option<i64>,
    /// The topic whose poses are taken in place of transforms.
    pub pose_from: Option<PoseSource>,
}

/// Why a mapping cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MappingError {
    /// The text is not a mapping; the message has the line.
    #[error("{0}")]
    Yaml(String),
    /// A key or a value of an entry is wrong.
    #[error("{key}: {problem}")]
    Entry {
        /// Key of the entry.
        key: String,
        /// The fault of the entry.
        problem: String,
    },
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct MappingText {
    skip: Vec<String>,
    grid: Vec<String>,
    states: BTreeMap<String, rule::StateText>,
    positions: BTreeMap<String, rule::PositionText>,
    traversals: BTreeMap<String, rule::TraversalText>,
    /// Seconds.
    transform_gap: Option<f64>,
    pose_from: Option<String>,
}

impl Mapping {
    /// Reads a mapping.
    ///
    /// # Errors
    /// The text is no mapping, or an entry is wrong.
    pub fn read(text: &str) -> Result<Self, MappingError> {
        if text.trim().is_empty() {
            return Ok(Self::default());
        }
        let read: MappingText = serde_saphyr::from_str(text).map_err(|error| MappingError::Yaml(error.to_string()))?;
        let states = read.states.into_iter().map(|(key, text)| StateRule::read(&key, text).map_err(entry(&key)));
        let positions =
            read.positions.into_iter().map(|(key, text)| PositionRule::read(&key, text).map_err(entry(&key)));
        let traversals =
            read.traversals.into_iter().map(|(key, text)| TraversalRule::read(&key, text).map_err(entry(&key)));
        let transform_gap_nanos = match read.transform_gap {
            None => None,
            Some(secs) if (0.0..=GAP_SECS_MAX).contains(&secs) => Some((secs * 1e9) as i64),
            Some(secs) => {
                return Err(entry("transform_gap")(format!("{secs} is no time: use seconds, 0 to {GAP_SECS_MAX}")));
            }
        };
        Ok(Self {
            transform_gap_nanos,
            pose_from: read.pose_from.as_deref().map(PoseSource::read),
            skip: read.skip,
            grid: read.grid,
            states: states.collect::<Result<_, _>>()?,
            positions: positions.collect::<Result<_, _>>()?,
            traversals: traversals.collect::<Result<_, _>>()?,
        })
    }

    /// The topics that the mapping names.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        let states = self.states.iter().map(|rule| rule.place.topic.as_str());
        let positions = self.positions.iter().map(|rule| rule.place.topic.as_str());
        let traversals = self.traversals.iter().map(|rule| rule.topic.as_str());
        let named = self.skip.iter().chain(&self.grid).map(String::as_str);
        named.chain(states).chain(positions).chain(traversals)
    }
}

fn entry(key: &str) -> impl FnOnce(String) -> MappingError {
    let key = key.to_owned();
    move |problem| MappingError::Entry { key, problem }
}

#[cfg(test)]
mod tests;
