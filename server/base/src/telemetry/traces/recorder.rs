//! Spans as OpenTelemetry records them.
//!
//! Invariant: there is one tracer for the whole process, made once at the start. The only data taken from the headers
//! is a context from outside, as the parent.

use std::sync::OnceLock;

use http::HeaderMap;
use opentelemetry::{
    Context, KeyValue,
    propagation::{Extractor, TextMapPropagator as _},
    trace::{SpanBuilder, SpanKind, Status, TraceContextExt as _, Tracer as _, TracerProvider as _},
};
use opentelemetry_sdk::{
    Resource,
    propagation::TraceContextPropagator,
    trace::{Sampler, SdkTracer, SdkTracerProvider},
};

use super::export::{Export, Spans};

/// The tracer. It is set once, if traces are configured.
static TRACER: OnceLock<SdkTracer> = OnceLock::new();

/// A span, which is recorded if its trace is.
#[derive(Clone)]
pub(super) struct Recorder(Context);

fn begin(builder: SpanBuilder, parent: &Context) -> Option<Recorder> {
    let tracer = TRACER.get()?;
    Some(Recorder(parent.with_span(tracer.build_with_context(builder, parent))))
}

impl Recorder {
    pub(super) fn child(&self, name: &'static str) -> Self {
        begin(SpanBuilder::from_name(name), &self.0).unwrap_or_else(|| self.clone())
    }

    pub(super) fn is_recorded(&self) -> bool {
        self.0.span().is_recording()
    }

    pub(super) fn text(&self, key: &'static str, value: String) {
        self.0.span().set_attribute(KeyValue::new(key, value));
    }

    pub(super) fn number(&self, key: &'static str, value: i64) {
        self.0.span().set_attribute(KeyValue::new(key, value));
    }

    pub(super) fn fail(&self, how: &'static str) {
        self.0.span().set_status(Status::error(how));
    }

    pub(super) fn end(&self) {
        self.0.span().end();
    }
}

/// The headers that may contain a trace context.
struct Headers<'headers>(&'headers HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key).and_then(|value| value.to_str().ok())
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(|key| key.as_str()).collect()
    }
}

pub(super) fn record_request(headers: &HeaderMap, method: &'static str) -> Option<Recorder> {
    TRACER.get()?;
    let parent = TraceContextPropagator::new().extract_with_context(&Context::new(), &Headers(headers));
    let path = method.trim_start_matches('/');
    let mut attributes = vec![KeyValue::new("rpc.system", "grpc")];
    if let Some((service, name)) = path.split_once('/') {
        attributes.extend([KeyValue::new("rpc.service", service), KeyValue::new("rpc.method", name)]);
    }
    begin(SpanBuilder::from_name(path).with_kind(SpanKind::Server).with_attributes(attributes), &parent)
}

pub(super) fn record_root(name: &'static str) -> Option<Recorder> {
    begin(SpanBuilder::from_name(name), &Context::new())
}

pub(super) fn check_build() -> anyhow::Result<()> {
    Ok(())
}

/// The sending of spans.
#[derive(Debug)]
pub struct Traces(Option<Export>);

impl Traces {
    /// Starts to send spans to the collector of this address, if there is one; must be called in the runtime. `ratio`:
    /// share of the traces that are recorded, unless their context decides it.
    ///
    /// # Errors
    /// The address cannot be used.
    pub fn start(otlp_endpoint: &str, ratio: f64) -> anyhow::Result<Self> {
        if otlp_endpoint.is_empty() {
            return Ok(Self(None));
        }
        // The resource also has the attributes of OTEL_RESOURCE_ATTRIBUTES.
        let resource = Resource::builder()
            .with_service_name("tidemapd")
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
            .build();
        let (spans, export) = Spans::start(otlp_endpoint, &resource)?;
        let provider = SdkTracerProvider::builder()
            .with_resource(resource)
            .with_sampler(Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(ratio))))
            .with_span_processor(spans)
            .build();
        // A second start has no effect: there is one daemon in a process.
        let _ = TRACER.set(provider.tracer("tidemapd"));
        Ok(Self(Some(export)))
    }

    /// Sends the ended spans, and stops. A collector that does not take them does not delay the stop for long.
    pub async fn stop(self) {
        if let Some(export) = self.0 {
            export.stop().await;
        }
    }
}
