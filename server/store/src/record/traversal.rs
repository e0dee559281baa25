//! Failed traversals as messages, and back.
//!
//! Invariant: decoding gives the encoded value.

use tidemap_map::{
    name::EdgeName,
    traversal::{EdgeFailure, kept_reason},
};
use tidemap_migrations::v1::site as v1;

use super::Invalid;

pub(super) fn encode_failure(failure: &EdgeFailure) -> v1::EdgeFailure {
    let EdgeFailure { edge: EdgeName { from, to, action }, start_nanos, end_nanos, reason } = failure;
    v1::EdgeFailure {
        from: from.as_str().to_owned(),
        to: to.as_str().to_owned(),
        action: action.as_ref().map_or_else(String::new, |action| action.as_str().to_owned()),
        start_nanos: *start_nanos,
        end_nanos: *end_nanos,
        reason: reason.clone(),
    }
}

pub(super) fn decode_failure(message: &v1::EdgeFailure) -> Result<EdgeFailure, Invalid> {
    let v1::EdgeFailure { from, to, action, start_nanos, end_nanos, reason } = message;
    let edge = EdgeName::new(from, to, action).map_err(|_| "the name of an edge is not valid")?;
    if kept_reason(reason) != *reason {
        return Err("the reason of a failure is too long or does not print");
    }
    Ok(EdgeFailure { edge, start_nanos: *start_nanos, end_nanos: *end_nanos, reason: reason.clone() })
}
