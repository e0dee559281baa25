//! No recorder: the daemon was built without the feature `traces`.
//!
//! Invariant: a setting that requests traces is refused, and no span is made.

use anyhow::bail;
use http::HeaderMap;

/// Takes the place of a recorded span. It has no values, because nothing is recorded.
#[derive(Clone)]
pub(super) enum Recorder {}

impl Recorder {
    pub(super) fn child(&self, _: &'static str) -> Self {
        match *self {}
    }

    pub(super) fn is_recorded(&self) -> bool {
        match *self {}
    }

    pub(super) fn text(&self, _: &'static str, _: String) {
        match *self {}
    }

    pub(super) fn number(&self, _: &'static str, _: i64) {
        match *self {}
    }

    pub(super) fn fail(&self, _: &'static str) {
        match *self {}
    }

    pub(super) fn end(&self) {
        match *self {}
    }
}

pub(super) fn record_request(_: &HeaderMap, _: &'static str) -> Option<Recorder> {
    None
}

pub(super) fn record_root(_: &'static str) -> Option<Recorder> {
    None
}

/// # Errors
/// Always: this build has no traces.
pub(super) fn check_build() -> anyhow::Result<()> {
    bail!("setting otlp_endpoint is set, and this tidemapd was built without traces: build it with --features traces")
}

/// The sending of spans: there is none.
#[derive(Debug)]
pub struct Traces;

impl Traces {
    /// Starts nothing.
    ///
    /// # Errors
    /// None.
    pub fn start(_: &str, _: f64) -> anyhow::Result<Self> {
        Ok(Self)
    }

    /// Stops nothing.
    pub async fn stop(self) {}
}
