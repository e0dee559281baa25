//! Failed traversals on the disk: one row with the newest failures; in the log they are stored with the observations
//! with which they arrive.
//!
//! Invariant: written data is read back without a change.

use tidemap_layout::site as layout;
use tidemap_map::{
    name::EdgeName,
    site::{Site, SiteEdit},
    traversal::{EdgeFailure, Failures, kept_reason},
};

use super::StoredTable;
use crate::record::Invalid;

pub(in crate::record) fn encode_failure(failure: &EdgeFailure) -> layout::EdgeFailure {
    let EdgeFailure { edge: EdgeName { from, to, action }, start_nanos, end_nanos, reason } = failure;
    layout::EdgeFailure {
        from: from.as_str().to_owned(),
        to: to.as_str().to_owned(),
        action: action.as_ref().map_or_else(String::new, |action| action.as_str().to_owned()),
        start_nanos: *start_nanos,
        end_nanos: *end_nanos,
        reason: reason.clone(),
    }
}

pub(in crate::record) fn decode_failure(message: &layout::EdgeFailure) -> Result<EdgeFailure, Invalid> {
    let layout::EdgeFailure { from, to, action, start_nanos, end_nanos, reason } = message;
    let edge = EdgeName::new(from, to, action).map_err(|_| "the name of an edge is not valid")?;
    if kept_reason(reason) != *reason {
        return Err("the reason of a failure is too long or does not print");
    }
    Ok(EdgeFailure { edge, start_nanos: *start_nanos, end_nanos: *end_nanos, reason: reason.clone() })
}

pub(super) enum FailedTraversals {}

impl StoredTable for FailedTraversals {
    const NUMBER: u32 = 6;
    type Row = layout::FailedTraversals;
    type Edit = ();

    fn count(site: &Site) -> usize {
        usize::from(site.failures().oldest_first().len() > 0)
    }

    fn rows(site: &Site) -> impl Iterator<Item = layout::FailedTraversals> {
        let failures: Vec<_> = site.failures().oldest_first().map(encode_failure).collect();
        (!failures.is_empty()).then_some(layout::FailedTraversals { failures }).into_iter()
    }

    fn restore(site: Site, rows: Vec<layout::FailedTraversals>, _: usize) -> Result<Site, String> {
        let mut failures = Failures::default();
        for failure in rows.iter().flat_map(|row| &row.failures) {
            failures.add(decode_failure(failure)?);
        }
        Ok(site.with_failures(failures))
    }

    fn encode_edit(_: &SiteEdit) -> Option<()> {
        None
    }

    fn decode_edit((): ()) -> Result<SiteEdit, Invalid> {
        Err("failed traversals come with observations alone")
    }
}
