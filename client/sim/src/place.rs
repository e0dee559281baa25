//! The rooms of the office, and what a robot sees of each.
//!
//! Invariant: every state is seen from exactly one place.

/// Where a person can be, and a robot can look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Between the rooms, at the entrance.
    Corridor,
    /// An office, from 0.
    Office(usize),
    Lab,
    MeetingRoom,
    Kitchen,
}

/// Names of the states; an index into this is a state.
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
pub(crate) const PLACES: [Place; 7] = [
    Place::Corridor,
    Place::Office(0),
    Place::Office(1),
    Place::Office(2),
    Place::Lab,
    Place::MeetingRoom,
    Place::Kitchen,
];

impl Place {
    /// The states that are seen from here.
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
