//! A request to erase data, by names.
//!
//! Invariant: a request names at least a state or a part.

use std::fmt;

use tidemap_model::time::format_rfc3339;

/// The data to erase, by names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErasureRequest {
    /// The state; `None`: a part of all states is erased.
    pub state: Option<String>,
    /// The observations to erase; `None`: all, and the state itself.
    pub part: Option<RequestedPart>,
}

/// Some of the observations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestedPart {
    /// The producer and its label; without a label, all labels.
    pub producer: Option<(String, Option<String>)>,
    /// Observations from this time on, nanoseconds UTC.
    pub from_nanos: i64,
    /// Observations before this time, nanoseconds UTC; `i64::MAX`: without end.
    pub to_nanos: i64,
    /// Whether the sequence of the producer is forgotten.
    pub forgets: bool,
}

impl fmt::Display for ErasureRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.state {
            Some(state) => write!(f, "state {state:?}")?,
            None => f.write_str("all states")?,
        }
        self.part.as_ref().map_or(Ok(()), |part| write!(f, ", {part}"))
    }
}

impl fmt::Display for RequestedPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.producer {
            Some((producer, Some(label))) => write!(f, "producer {producer:?} with label {label:?}, ")?,
            Some((producer, None)) => write!(f, "producer {producer:?}, ")?,
            None => {}
        }
        write!(f, "from {}", format_rfc3339(self.from_nanos))?;
        match self.to_nanos {
            i64::MAX => f.write_str(" on"),
            nanos => write!(f, " to {}", format_rfc3339(nanos)),
        }
    }
}
