//! Spans: the work of the daemon and its duration, for a collector of OpenTelemetry.
//!
//! Invariant: making and ending a span never waits, and causes no failure. A span contains only values that the code
//! names here, such as method, map, code and counts. It never contains data of a client, a path, a token or a key.
//! Without `otlp_endpoint`, no spans are made.

use std::{fmt, future::Future};

use anyhow::{bail, ensure};
use http::HeaderMap;

#[cfg(feature = "traces")]
mod export;
#[cfg_attr(feature = "traces", path = "traces/recorder.rs")]
#[cfg_attr(not(feature = "traces"), path = "traces/no_recorder.rs")]
mod recorder;

pub use recorder::Traces;
use recorder::{Recorder, record_request, record_root};

/// Checks the settings of traces.
///
/// # Errors
/// A setting that cannot be used, with its name.
pub fn check(otlp_endpoint: &str, trace_ratio: f64) -> anyhow::Result<()> {
    ensure!((0.0..=1.0).contains(&trace_ratio), "setting trace_ratio is {trace_ratio}: it must be between 0 and 1");
    if otlp_endpoint.is_empty() {
        return Ok(());
    }
    let uri = otlp_endpoint.parse::<http::Uri>().ok();
    let is_usable = uri.is_some_and(|uri| uri.scheme_str() == Some("http") && uri.authority().is_some());
    if !is_usable {
        bail!(
            "setting otlp_endpoint is {otlp_endpoint:?}: it must be http://HOST:PORT, for example \
             http://127.0.0.1:4317. Where the way to the collector is not trusted, run an agent on this machine"
        );
    }
    recorder::check_build()
}

tokio::task_local! {
    /// The span of the request that the task works on.
    static SPAN: Span;
}

/// Something that begins and ends. Clones are the same span; it ends with [`Span::end`], or with the last of them.
#[derive(Clone, Default)]
pub struct Span(Option<Recorder>);

impl fmt::Debug for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Span").field(&self.0.is_some()).finish()
    }
}

impl Span {
    /// The span of a request: a part of the trace whose context is in the headers, or a trace of its own. Only requests
    /// of this API have spans.
    pub fn of_request(headers: &HeaderMap, method: &'static str) -> Self {
        if method.starts_with("/tidemap.") { Self(record_request(headers, method)) } else { Self(None) }
    }

    /// A span that begins a trace.
    pub fn root(name: &'static str) -> Self {
        Self(record_root(name))
    }

    /// A part of this span, which begins now.
    pub fn child(&self, name: &'static str) -> Self {
        Self(self.0.as_ref().map(|span| span.child(name)))
    }

    /// The span of the request that this task works on, if it has one.
    pub fn current() -> Self {
        SPAN.try_with(Clone::clone).unwrap_or_default()
    }

    /// Does the work for this span.
    pub fn scope<F: Future>(self, work: F) -> impl Future<Output = F::Output> {
        SPAN.scope(self, work)
    }

    /// Whether the span is recorded.
    pub fn is_recorded(&self) -> bool {
        self.0.as_ref().is_some_and(Recorder::is_recorded)
    }

    /// Adds a name or a word.
    pub fn text(&self, key: &'static str, value: impl fmt::Display) {
        if let Some(span) = self.0.as_ref().filter(|span| span.is_recorded()) {
            span.text(key, value.to_string());
        }
    }

    /// Adds a number.
    pub fn number(&self, key: &'static str, value: u64) {
        if let Some(span) = &self.0 {
            span.number(key, i64::try_from(value).unwrap_or(i64::MAX));
        }
    }

    /// Marks the span as failed; the text is a constant of the code, such as the code of a status.
    pub fn fail(&self, how: &'static str) {
        if let Some(span) = &self.0 {
            span.fail(how);
        }
    }

    /// Ends the span; later events are not recorded.
    pub fn end(&self) {
        if let Some(span) = &self.0 {
            span.end();
        }
    }
}
