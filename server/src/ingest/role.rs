//! What this daemon is to a map: its only writer, or the writer or a follower of a log that daemons share.
//!
//! Invariant: only a daemon whose role writes takes what clients send.

use tidemap_map::name::MapName;

/// What this daemon is to a map.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) enum MapRole {
    /// The log is this daemon's alone.
    #[default]
    Alone,
    /// It writes the log that daemons share.
    Writing {
        /// The epoch, which the log says.
        epoch: u64,
    },
    /// It follows the log.
    Following {
        /// The daemon that writes, where it is known.
        writer: Option<String>,
    },
}

impl MapRole {
    /// The role in a log that daemons share, before more is known.
    pub(crate) const UNKNOWN: MapRole = MapRole::Following { writer: None };

    /// The role before the replica of the map, if there is one, has told anything.
    pub(crate) fn at_first(is_shared: bool) -> MapRole {
        if is_shared { Self::UNKNOWN } else { Self::Alone }
    }

    /// Whether daemons share the log.
    pub(crate) fn is_shared(&self) -> bool {
        *self != Self::Alone
    }

    /// Whether this daemon writes the map.
    pub(crate) fn is_writing(&self) -> bool {
        !matches!(self, Self::Following { .. })
    }

    /// Why this daemon takes nothing from clients; `None`: it does.
    pub(crate) fn not_writer(&self, map: &MapName) -> Option<NotWriter> {
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
pub(crate) struct NotWriter {
    /// The map.
    pub map: MapName,
    /// The daemon that does, where it is known.
    pub writer: Option<String>,
}
