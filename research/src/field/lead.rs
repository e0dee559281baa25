//! Lead times: how much earlier than a reading the knowledge ends that predicts it.
//!
//! Invariant: readings of the newest midnight's day are known to short lead times only.

/// Seconds of an hour in nanoseconds.
pub(super) const HOUR_NANOS: i64 = 3_600_000_000_000;

/// A lead time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lead {
    /// Five minutes.
    FiveMinutes,
    /// An hour.
    Hour,
    /// The readings of the day are not known.
    Day,
    /// The readings of the last seven days are not known, today's included.
    Week,
    /// The readings of the last 28 days are not known, today's included.
    FourWeeks,
}

/// The end of the knowledge of a lead time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KnownUntil {
    /// This many nanoseconds before the reading, which is included.
    Nanos(i64),
    /// The local midnight before the reading, or this many midnights before that one.
    Midnight(usize),
}

impl Lead {
    /// All lead times, from short to long.
    pub const ALL: [Lead; 5] = [Lead::FiveMinutes, Lead::Hour, Lead::Day, Lead::Week, Lead::FourWeeks];

    /// The name in results.
    pub fn name(self) -> &'static str {
        match self {
            Lead::FiveMinutes => "5m",
            Lead::Hour => "1h",
            Lead::Day => "1d",
            Lead::Week => "7d",
            Lead::FourWeeks => "28d",
        }
    }

    pub(super) fn known_until(self) -> KnownUntil {
        match self {
            Lead::FiveMinutes => KnownUntil::Nanos(HOUR_NANOS / 12),
            Lead::Hour => KnownUntil::Nanos(HOUR_NANOS),
            Lead::Day => KnownUntil::Midnight(0),
            Lead::Week => KnownUntil::Midnight(6),
            Lead::FourWeeks => KnownUntil::Midnight(27),
        }
    }

    /// Whether readings of the same day are known, so that the newest of them can be blended in.
    pub(super) fn is_short(self) -> bool {
        matches!(self.known_until(), KnownUntil::Nanos(_))
    }

    /// The whole weeks by which a reading of the same hour is earlier that is always known.
    pub(super) fn weeks(self) -> i64 {
        if self == Lead::FourWeeks { 4 } else { 1 }
    }
}
