//! The reporting of a state whose rows are no readings, and the stored data of its rows.
//!
//! Invariant: a frozen layout. Fields may be added, none may change.

/// How the rows of a state come about that are no readings.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Reporting {
    /// 1 changes, 2 events.
    #[prost(uint32, tag = "1")]
    pub kind: u32,
    /// The longest time for which a row is valid, seconds.
    #[prost(uint32, tag = "2")]
    pub max_secs: u32,
    /// The time between two readings that rows represent, seconds.
    #[prost(uint32, tag = "3")]
    pub step_secs: u32,
}

/// A row: a value, or that none is known from then on.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Row {
    /// Nanoseconds UTC.
    #[prost(sfixed64, tag = "1")]
    pub nanos: i64,
    /// Absent: none is known.
    #[prost(fixed64, optional, tag = "2")]
    pub value_bits: Option<u64>,
}

/// The newest row that arrived.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct NewestRow {
    /// Nanoseconds UTC.
    #[prost(sfixed64, tag = "1")]
    pub nanos: i64,
    /// Whether the row has a value.
    #[prost(bool, tag = "2")]
    pub has_value: bool,
    /// Whether the row arrived when it was made.
    #[prost(bool, tag = "3")]
    pub is_live: bool,
    /// The producer that sent it.
    #[prost(uint32, tag = "4")]
    pub producer: u32,
    /// Events of its step.
    #[prost(fixed64, tag = "5")]
    pub events_bits: u64,
}

/// The rows of a state that reports changes or events.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Rows {
    #[prost(message, optional, tag = "1")]
    pub reporting: Option<Reporting>,
    /// Number of rows that are learned.
    #[prost(uint64, tag = "2")]
    pub learned: u64,
    /// The first instant that was learned, nanoseconds UTC; absent: none was.
    #[prost(sfixed64, optional, tag = "3")]
    pub first_nanos: Option<i64>,
    /// The next instant to learn, nanoseconds UTC.
    #[prost(sfixed64, tag = "4")]
    pub next_nanos: i64,
    /// The newest row that is learned.
    #[prost(message, optional, tag = "5")]
    pub newest_learned: Option<Row>,
    /// Events since the next instant; absent: there is no row of such.
    #[prost(fixed64, optional, tag = "6")]
    pub open_events_bits: Option<u64>,
    /// The newest row that arrived.
    #[prost(message, optional, tag = "7")]
    pub newest: Option<NewestRow>,
    /// Rows that were taken and are not learned yet, ascending by time.
    #[prost(message, repeated, tag = "8")]
    pub waiting: Vec<Row>,
}
