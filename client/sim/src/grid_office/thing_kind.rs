//! The kinds of things that change in the grid office.

/// The kind of a thing. `shapes` defines the poses of each kind, `routine` the times at which a thing takes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ThingKind {
    /// A person at a desk, and the chair.
    Workplace,
    /// Things that a person brings along and takes home.
    Belongings,
    /// A door leaf.
    Door,
    /// A curtain before the window of a room.
    Curtain,
    /// A path along the corridor.
    Way,
    /// Standing room at a counter; the pose is the number of people.
    Kitchen,
    /// Seats at a table; the pose is the number of people.
    Meeting,
    /// A box that stands in the corridor for days at a time.
    Parcel,
    /// Edges that the sensor measures wrongly now and then, day and night.
    Edge,
    /// Edges that the sensor measures wrongly in the light of working days.
    DaylightEdge,
}
