//! Errors of requests that are neither answered here nor passed on.
//!
//! Invariant: the message states whether to try again.

use std::time::Duration;

use tidemap_proto::read_token::{InvalidReadToken, ReadToken};
use tonic::Code;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GatewayError {
    #[error("no daemon is known to write map {map:?} now: try again")]
    NoWriter { map: String },
    #[error("map {map:?} is written by {writer}, which this daemon cannot reach: {why}. Try again")]
    NoWay { map: String, writer: String, why: String },
    #[error("{by} passed the request to this daemon, but this daemon no longer writes map {map:?}: try again")]
    Moved { map: String, by: String },
    #[error("the connection to {member} broke before the reply had ended: try again")]
    Broke { member: String },
    #[error("the time for the request was over before {member} responded")]
    Late { member: String },
    #[error(
        "this daemon has not received the end of the log of map {map:?} for {} seconds, and its data may be old: try \
         again, use another daemon, or send the metadata tidemap-allow-stale: 1", .max.as_secs()
    )]
    Stale { map: String, max: Duration },
    #[error("the writer of map {map:?} does not have {wanted} yet, which the client has seen: try again")]
    Behind { map: String, wanted: ReadToken },
    #[error("job {id} is not known here, and {member}, which may have it, cannot be reached: {why}. Try again")]
    JobAway { id: u64, member: String, why: String },
    #[error(transparent)]
    Token(#[from] InvalidReadToken),
}

impl GatewayError {
    pub(super) fn code_and_reason(&self) -> (Code, &'static str) {
        match self {
            Self::NoWriter { .. } => (Code::Unavailable, "NO_WRITER"),
            Self::NoWay { .. } | Self::JobAway { .. } | Self::Broke { .. } => (Code::Unavailable, "UNREACHABLE"),
            Self::Moved { .. } => (Code::Unavailable, "NOT_WRITER"),
            Self::Late { .. } => (Code::DeadlineExceeded, "LATE"),
            Self::Stale { .. } => (Code::Unavailable, "STALE"),
            Self::Behind { .. } => (Code::Unavailable, "BEHIND"),
            Self::Token(_) => (Code::InvalidArgument, "INVALID_FIELD"),
        }
    }
}
