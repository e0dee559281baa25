//! The statement of a user about how a state is reported.
//!
//! Invariant: a statement, completed with the default durations, is a reporting that a state can have.

use super::{Hold, InvalidHold, Reporting};

/// The meaning of rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum RowKind {
    /// Rows are readings.
    #[default]
    Samples,
    /// Rows are changes: a value from then on.
    Changes,
    /// Rows are events.
    Events,
}

impl RowKind {
    /// All kinds of rows.
    pub const ALL: [RowKind; 3] = [RowKind::Samples, RowKind::Changes, RowKind::Events];

    /// The name in commands and messages.
    pub fn name(self) -> &'static str {
        match self {
            RowKind::Samples => "samples",
            RowKind::Changes => "changes",
            RowKind::Events => "events",
        }
    }
}

/// A statement about a state: the kind of its rows, and durations if they differ from the defaults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatedReporting {
    kind: RowKind,
    max_secs: Option<u32>,
    step_secs: Option<u32>,
}

/// The reason why a statement is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidReporting {
    /// A duration is outside its range.
    #[error(transparent)]
    Hold(#[from] InvalidHold),
    /// Samples have no durations.
    #[error("samples neither hold nor have a step: only changes and events do")]
    SamplesHold,
}

impl StatedReporting {
    /// Creates a statement. `max_secs`: the longest time for which a row holds; `step_secs`: the time between two
    /// readings that rows represent; both in seconds, `None`: not stated.
    ///
    /// # Errors
    /// [`InvalidReporting`] if no state can be reported like that.
    pub fn new(
        kind: RowKind,
        max_secs: Option<u32>,
        step_secs: Option<u32>,
    ) -> Result<StatedReporting, InvalidReporting> {
        let stated = StatedReporting { kind, max_secs, step_secs };
        if kind == RowKind::Samples && (max_secs, step_secs) != (None, None) {
            return Err(InvalidReporting::SamplesHold);
        }
        let Hold { max_secs, step_secs } = stated.hold();
        Hold::new(max_secs, step_secs)?;
        Ok(stated)
    }

    /// The meaning of the rows.
    pub fn kind(self) -> RowKind {
        self.kind
    }

    /// The longest time for which a row holds, in seconds, if it is stated.
    pub fn max_secs(self) -> Option<u32> {
        self.max_secs
    }

    /// The time from one reading to the next, in seconds, if it is stated.
    pub fn step_secs(self) -> Option<u32> {
        self.step_secs
    }

    fn hold(self) -> Hold {
        let usual = if self.kind == RowKind::Events { Hold::OF_EVENTS } else { Hold::OF_CHANGES };
        let max_secs = self.max_secs.unwrap_or(usual.max_secs);
        Hold { max_secs, step_secs: self.step_secs.unwrap_or(usual.step_secs.min(max_secs).max(1)) }
    }

    /// How a new state is reported.
    pub fn for_new(self) -> Reporting {
        match self.kind {
            RowKind::Samples => Reporting::Samples,
            RowKind::Changes => Reporting::Changes(self.hold()),
            RowKind::Events => Reporting::Events(self.hold()),
        }
    }

    /// Whether the statement is true for a state that is reported like this.
    pub fn fits(self, found: Reporting) -> bool {
        let fits = |stated: Option<u32>, found: u32| stated.is_none_or(|stated| stated == found);
        self.kind == found.kind()
            && found
                .hold()
                .is_none_or(|hold| fits(self.max_secs, hold.max_secs) && fits(self.step_secs, hold.step_secs))
    }
}

impl From<Reporting> for StatedReporting {
    fn from(reporting: Reporting) -> StatedReporting {
        let hold = reporting.hold();
        StatedReporting {
            kind: reporting.kind(),
            max_secs: hold.map(Hold::max_secs),
            step_secs: hold.map(Hold::step_secs),
        }
    }
}

impl std::fmt::Display for StatedReporting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.for_new().fmt(f)
    }
}
