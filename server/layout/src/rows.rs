//! The reporting of a state whose rows are not readings, and the stored data of its rows.
//!
//! Invariant: the layout is frozen. Fields may be added, but none may change.

/// The reporting of a state whose rows are not readings.
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

/// A row: a value, or the end of the known values.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Row {
    /// Time of the row, nanoseconds UTC.
    #[prost(sfixed64, tag = "1")]
    pub nanos: i64,
    /// Value of the row; absent: from then on no value is known.
    #[prost(fixed64, optional, tag = "2")]
    pub value_bits: Option<u64>,
}

/// The newest row that arrived.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct NewestRow {
    /// Time of the row, nanoseconds UTC.
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
    /// Number of events in the step of the row.
    #[prost(fixed64, tag = "5")]
    pub events_bits: u64,
}

/// The rows of a state that reports changes or events.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Rows {
    #[prost(message, optional, tag = "1")]
    pub reporting: Option<Reporting>,
    /// Number of rows so far, including the rows that wait.
    #[prost(uint64, tag = "2")]
    pub learned: u64,
    /// The first instant that was learned, nanoseconds UTC; absent: no instant was learned.
    #[prost(sfixed64, optional, tag = "3")]
    pub first_nanos: Option<i64>,
    /// The next instant to learn, nanoseconds UTC.
    #[prost(sfixed64, tag = "4")]
    pub next_nanos: i64,
    /// The newest row that is learned.
    #[prost(message, optional, tag = "5")]
    pub newest_learned: Option<Row>,
    /// Number of events since `next_nanos`, which wait for the end of their step; absent: there is no row since then.
    #[prost(fixed64, optional, tag = "6")]
    pub open_events_bits: Option<u64>,
    /// The newest row that arrived.
    #[prost(message, optional, tag = "7")]
    pub newest: Option<NewestRow>,
    /// Rows that were accepted and are not learned yet, ascending by time.
    #[prost(message, repeated, tag = "8")]
    pub waiting: Vec<Row>,
}
