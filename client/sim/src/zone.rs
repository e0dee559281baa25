//! The error for a time zone that the IANA database does not have.

/// The time zone database has no zone of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("time zone {0:?} is not known: use a name of the IANA database, for example \"Europe/London\"")]
pub struct UnknownZone(pub String);
