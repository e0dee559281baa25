//! Names of maps, states and producers.
//!
//! Invariant: a value of these types is valid; the constructors are the only way to make one. A name is never used as a
//! path.

use std::{borrow::Cow, fmt, sync::Arc};

use tidemap_model::{ANGLE_AXES, Dimensions};
use unicode_normalization::is_nfc;

mod edge;
mod label;
mod landmark;
mod task;

pub use edge::{EDGE_STATE_CHARS_MAX, EdgeName, EdgeState};
pub use landmark::{LANDMARK_STATE_CHARS_MAX, PlaceName};
pub use task::TaskName;

/// Maximum number of characters of a state's or producer's name.
pub const NAME_CHARS_MAX: usize = 128;
/// Maximum number of characters of a map's name.
pub(crate) const MAP_NAME_CHARS_MAX: usize = 63;

/// The reason why a name is not accepted. The payload is the name, shortened; messages quote and escape it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidName {
    /// A map's name has characters that are not allowed, or is empty or too long.
    #[error(
        "map name {0:?} is not valid: use 1 to {MAP_NAME_CHARS_MAX} of the characters a-z 0-9 _ -, the first a letter \
         or digit"
    )]
    Map(String),
    /// The name is empty.
    #[error("name is empty: use 1 to {NAME_CHARS_MAX} printable characters")]
    Empty,
    /// The name is too long.
    #[error("name {name:?} has {chars} characters: at most {NAME_CHARS_MAX} are allowed")]
    TooLong {
        /// The name, shortened.
        name: String,
        /// The length of the name in characters.
        chars: usize,
    },
    /// The name contains a control, format or other unprintable character.
    #[error("name {name:?} contains the unprintable character U+{code:04X}")]
    Unprintable {
        /// The name, shortened.
        name: String,
        /// The code point of the character.
        code: u32,
    },
    /// The name is not in Unicode normalisation form C, so that two different names could appear identical.
    #[error("name {0:?} is not in Unicode normalisation form C (NFC)")]
    NotNfc(String),
    /// The name contains a slash, which is reserved for `edge/A/B`, `node/N` and similar names.
    #[error("name {0:?} contains '/', which is reserved for cells, edges, nodes and landmarks")]
    Slash(String),
    /// The name is not allowed for a vector, an angle or a categorical state: the names of its parts would be like
    /// those of a cell, an edge, a node or a landmark.
    #[error(
        "name {0:?} is not for a vector or an angle, nor for a categorical state: {0}/x is how cells, edges, \
         nodes and landmarks are called"
    )]
    Reserved(String),
    /// A label has the name of an axis of a vector or an angle.
    #[error("label {0:?} is the name of an axis of a vector or of an angle: use another word")]
    Axis(String),
    /// A name of a label without its state.
    #[error("name {0:?} is not a label of a state, which is called STATE/LABEL")]
    NoLabel(String),
}

fn shown(name: &str) -> String {
    name.chars().take(40).collect()
}

/// Characters that are not printable, or that change how others are printed (bidirectional controls, zero-width marks).
pub(crate) fn unprintable(character: char) -> bool {
    character.is_control()
        || matches!(u32::from(character),
            0xAD | 0x600..=0x605 | 0x61C | 0x6DD | 0x70F | 0x180E | 0x200B..=0x200F | 0x2028..=0x202E
            | 0x2060..=0x206F | 0xD800..=0xF8FF | 0xFEFF | 0xFFF0..=0xFFFB | 0xFFFE | 0xFFFF | 0xE0000..=0xE0FFF
            | 0xF0000..=0x10FFFF)
}

/// A text in a form that a terminal may show: unprintable characters are escaped, an ESC as `\u{1b}`.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(unprintable) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 8);
    for character in text.chars() {
        if unprintable(character) {
            escaped.extend(character.escape_unicode());
        } else {
            escaped.push(character);
        }
    }
    Cow::Owned(escaped)
}

fn check(name: &str) -> Result<(), InvalidName> {
    if name.is_empty() {
        return Err(InvalidName::Empty);
    }
    // A cheap bound comes first: a name of 64 KiB is refused before its characters are counted.
    let chars = if name.len() > 4 * NAME_CHARS_MAX { name.len() / 4 } else { name.chars().count() };
    if chars > NAME_CHARS_MAX {
        return Err(InvalidName::TooLong { name: shown(name), chars: name.chars().count() });
    }
    if let Some(character) = name.chars().find(|&character| unprintable(character)) {
        return Err(InvalidName::Unprintable { name: shown(name), code: u32::from(character) });
    }
    if !is_nfc(name) {
        return Err(InvalidName::NotNfc(shown(name)));
    }
    Ok(())
}

/// Name of a map: `[a-z0-9][a-z0-9_-]{0,62}`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapName(String);

impl MapName {
    /// Checks a map's name.
    ///
    /// # Errors
    /// [`InvalidName::Map`].
    pub fn new(name: &str) -> Result<Self, InvalidName> {
        let allowed = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let bytes = name.as_bytes();
        let valid = bytes.len() <= MAP_NAME_CHARS_MAX
            && bytes.first().is_some_and(|&first| allowed(first))
            && bytes.iter().all(|&byte| allowed(byte) || byte == b'_' || byte == b'-');
        if valid { Ok(Self(name.to_owned())) } else { Err(InvalidName::Map(shown(name))) }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for MapName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// First parts that the name of a vector, an angle or a categorical state may not have.
const RESERVED: [&str; 4] = ["cell", "edge", "node", "landmark"];

/// `NAME/x` as name and number of the axis.
fn split_axis(name: &str) -> Option<(&str, usize)> {
    let (vector, axis) = name.rsplit_once('/')?;
    // A vector has a plain name: the name `node/N/x` is a state at a node.
    Some((vector, Dimensions::axis(axis)?)).filter(|(vector, _)| !vector.contains('/'))
}

/// `NAME/cos` or `NAME/sin` as name and number of the axis.
fn split_angle_axis(name: &str) -> Option<(&str, usize)> {
    let (angle, axis) = name.rsplit_once('/')?;
    let axis = ANGLE_AXES.iter().position(|other| *other == axis)?;
    Some((angle, axis)).filter(|(angle, _)| !angle.contains('/'))
}

/// `node/N/KIND` as the node and the kind of the object there.
fn split_object(name: &str) -> Option<(&str, &str)> {
    name.strip_prefix("node/")?.split_once('/')
}

/// The name of the state that a query name refers to: `node/N`, of the default kind, is the plain state N.
pub(crate) fn referred_name(name: &str) -> &str {
    name.strip_prefix("node/").filter(|node| !node.contains('/')).unwrap_or(name)
}

/// Name of a state: 1 to 128 printable characters in NFC, case-sensitive, without `/`. It can also be the name of an
/// axis of a vector, which is such a name with `/x`, `/y` or `/z`, or of an axis of an angle, with `/cos` or `/sin`; or
/// `node/N/KIND`, for whether an object of a kind is at node N; or the name of a state of an edge or a task,
/// [`EdgeName::state`] and [`TaskName::state`], of a landmark, [`PlaceName::landmark`], or of a label,
/// [`StateName::label`].
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StateName(Arc<str>);

impl StateName {
    /// Checks a state's name.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn new(name: &str) -> Result<Self, InvalidName> {
        check(name)?;
        if name.contains('/') {
            return Err(InvalidName::Slash(shown(name)));
        }
        Ok(Self(name.into()))
    }

    /// Checks a name like [`StateName::new`]; also accepts `node/N`, which is the plain name N, and `node/N/KIND` with
    /// plain names for node and kind, 128 characters in all. The node need not exist: it may be added later.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn observed(name: &str) -> Result<Self, InvalidName> {
        let Some((node, kind)) = split_object(name) else { return Self::new(referred_name(name)) };
        check(name)?;
        Self::new(node)?;
        Self::new(kind)?;
        Ok(Self(name.into()))
    }

    /// Name of the state of one axis of a vector with this name: `NAME/x` for axis 0. A plain name has no `/`, so a
    /// producer can observe such a state only by positions.
    pub fn axis(&self, axis: usize) -> Self {
        let axis = Dimensions::Three.axes().get(axis).copied().unwrap_or_default();
        Self(format!("{}/{axis}", self.0).into())
    }

    /// Name of the state of the cosine (axis 0) or the sine (axis 1) of an angle with this name: `NAME/cos` or
    /// `NAME/sin`.
    #[must_use]
    pub fn angle_axis(&self, axis: usize) -> Self {
        let axis = ANGLE_AXES.get(axis).copied().unwrap_or_default();
        Self(format!("{}/{axis}", self.0).into())
    }

    /// Checks that a vector, an angle or a categorical state may have the name.
    ///
    /// # Errors
    /// [`InvalidName::Reserved`].
    pub fn check_vector(&self) -> Result<(), InvalidName> {
        if RESERVED.contains(&&*self.0) || self.0.contains('/') {
            Err(InvalidName::Reserved(shown(&self.0)))
        } else {
            Ok(())
        }
    }

    /// Checks a name like [`StateName::observed`]; also accepts the names of axes of vectors and angles, as
    /// [`StateName::axis`] and [`StateName::angle_axis`] return them, and the names of states of edges, tasks and
    /// landmarks, as [`EdgeName::state`], [`TaskName::state`] and [`PlaceName::landmark`] return them.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn stored(name: &str) -> Result<Self, InvalidName> {
        if let Some((what, edge)) = edge::split_edge(name) {
            return Ok(EdgeName::parse(edge)?.state(what));
        }
        if let Some(parts) = landmark::split(name) {
            return parts.map(|(place, id)| place.landmark(&id));
        }
        if let Some(task) = task::split_task(name) {
            return Ok(TaskName::parse(task)?.state());
        }
        if let Some((angle, axis)) = split_angle_axis(name) {
            let angle = Self::new(angle)?;
            angle.check_vector()?;
            return Ok(angle.angle_axis(axis));
        }
        match split_axis(name) {
            Some((vector, axis)) => {
                let vector = Self::new(vector)?;
                vector.check_vector()?;
                Ok(vector.axis(axis))
            }
            None => Self::observed(name),
        }
    }

    /// The name of the state after node `from` is renamed to `to`; `None` if the state does not belong to the node. The
    /// node's own name, `node/N/KIND`, and the names of edges at the node, of tasks and of landmarks there belong to
    /// it.
    ///
    /// # Errors
    /// [`InvalidName::TooLong`].
    pub(crate) fn with_node_renamed(&self, from: &str, to: &StateName) -> Option<Result<Self, InvalidName>> {
        if let Some((what, edge)) = self.as_edge() {
            return edge.with_node_renamed(from, to).map(|edge| Ok(edge.state(what)));
        }
        if let Some(renamed) = landmark::with_node_renamed(self, from, to) {
            return Some(Ok(renamed));
        }
        if let Some(task) = self.as_task() {
            return (task.node.as_str() == from).then(|| Ok(TaskName { node: to.clone(), ..task }.state()));
        }
        if self.as_str() == from {
            return Some(Ok(to.clone()));
        }
        let (_, kind) = split_object(&self.0).filter(|(node, _)| *node == from)?;
        let name = format!("node/{to}/{kind}");
        Some(check(&name).map(|()| Self(name.into())))
    }

    /// Maximum number of characters that a state's name of this form may have: names of the states of edges, tasks and
    /// landmarks are longer than others.
    pub fn chars_max(name: &str) -> usize {
        match landmark::split(name) {
            Some(_) => LANDMARK_STATE_CHARS_MAX,
            None if edge::split_edge(name).is_some() || task::split_task(name).is_some() => EDGE_STATE_CHARS_MAX,
            None => NAME_CHARS_MAX,
        }
    }

    /// If this is the name of an axis: the name of its vector, and the axis, 0 for x.
    pub fn as_axis(&self) -> Option<(&str, usize)> {
        split_axis(&self.0)
    }

    /// If this is the name of an axis of an angle: the name of the angle, and the axis, 0 for the cosine.
    #[must_use]
    pub fn as_angle_axis(&self) -> Option<(&str, usize)> {
        split_angle_axis(&self.0)
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl std::borrow::Borrow<str> for StateName {
    fn borrow(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for StateName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A sequence of observations: a producer and one of its labels.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ProducerKey {
    producer: Box<str>,
    label: Box<str>,
}

impl ProducerKey {
    /// Checks a producer's name (1 to 128 printable characters in NFC) and label (0 to 128).
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn new(producer: &str, label: &str) -> Result<Self, InvalidName> {
        check(producer)?;
        if !label.is_empty() {
            check(label)?;
        }
        Ok(Self { producer: producer.into(), label: label.into() })
    }

    /// The name of the producer that streams.
    pub fn producer(&self) -> &str {
        &self.producer
    }

    /// The label, which distinguishes the producer's sequences; may be empty.
    pub fn label(&self) -> &str {
        &self.label
    }
}

#[cfg(test)]
mod tests;
