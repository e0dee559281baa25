//! The role of this daemon for a map: its only writer, or the writer or a follower of a shared log.
//!
//! Invariant: only a daemon with a writing role accepts data from clients.

use tidemap_map::name::MapName;

/// The role of this daemon for a map.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum MapRole {
    /// The log belongs to this daemon alone.
    #[default]
    Alone,
    /// This daemon writes the shared log.
    Writing {
        /// The epoch, which the log records.
        epoch: u64,
    },
    /// This daemon follows the log.
    Following {
        /// The daemon that writes the log, where it is known.
        writer: Option<String>,
    },
}

impl MapRole {
    /// The role for a shared log, before more is known.
    pub const UNKNOWN: MapRole = MapRole::Following { writer: None };

    /// The role before the first event of the map's replica, if there is one.
    pub(crate) fn at_first(is_shared: bool) -> MapRole {
        if is_shared { Self::UNKNOWN } else { Self::Alone }
    }

    /// Whether the log is shared.
    pub fn is_shared(&self) -> bool {
        *self != Self::Alone
    }

    /// Whether this daemon writes the map.
    pub fn is_writing(&self) -> bool {
        !matches!(self, Self::Following { .. })
    }

    /// The reason why this daemon accepts nothing from clients; `None`: it accepts data.
    pub fn not_writer(&self, map: &MapName) -> Option<NotWriter> {
        match self {
            Self::Alone | Self::Writing { .. } => None,
            Self::Following { writer } => Some(NotWriter { map: map.clone(), writer: writer.clone() }),
        }
    }
}

/// This daemon does not write the map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "this daemon does not write map {map}{}",
    writer.as_ref().map_or_else(|| ": another daemon does, try again".to_owned(), |writer| format!("; {writer} does"))
)]
pub struct NotWriter {
    /// The map.
    pub map: MapName,
    /// The daemon that writes the map, where it is known.
    pub writer: Option<String>,
}
