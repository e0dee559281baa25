//! The rooms of the simulated office, its states, and which states a robot sees from which room.
//!
//! Invariant: every state is seen from exactly one place.

/// A place where a person can be or where a robot stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OfficePlace {
    /// Between the rooms, at the entrance.
    Corridor,
    /// An office, counted from 0.
    Office(usize),
    Lab,
    MeetingRoom,
    Kitchen,
}

/// Names of the states; an index into this is a state. States 1 to 6 are whether a person is at the place with the same
/// index in [`PLACES`].
pub(crate) const STATES: [&str; 9] = [
    "entrance-door",
    "office-1-door",
    "office-2-door",
    "office-3-door",
    "lab-door",
    "meeting-room",
    "kitchen",
    "storage-door",
    "corridor-door",
];

/// Every place, in the order of the corridor.
pub(crate) const PLACES: [OfficePlace; 7] = [
    OfficePlace::Corridor,
    OfficePlace::Office(0),
    OfficePlace::Office(1),
    OfficePlace::Office(2),
    OfficePlace::Lab,
    OfficePlace::MeetingRoom,
    OfficePlace::Kitchen,
];

impl OfficePlace {
    /// The states that a robot sees from here.
    pub(crate) fn states(self) -> &'static [usize] {
        match self {
            Self::Corridor => &[0, 8],
            Self::Office(0) => &[1],
            Self::Office(1) => &[2],
            Self::Office(_) => &[3],
            Self::Lab => &[4],
            Self::MeetingRoom => &[5],
            // The storage door is at the back of the kitchen.
            Self::Kitchen => &[6, 7],
        }
    }
}
