//! The way of ended spans to the collector.
//!
//! Invariant: an ended span is put into a bounded queue, or dropped and counted; nothing waits. One task sends; if the
//! collector is absent, slow or broken, only spans are lost. A batch is sent once.

use std::time::Duration;

use opentelemetry::Context;
use opentelemetry_otlp::{SpanExporter, WithExportConfig as _};
use opentelemetry_sdk::{
    Resource,
    error::OTelSdkResult,
    trace::{Span, SpanData, SpanExporter as _, SpanProcessor},
};
use tokio::{
    sync::{mpsc, oneshot},
    task::JoinHandle,
    time::{Instant, sleep, timeout, timeout_at},
};
use tracing::{info, warn};

/// Maximum number of waiting spans. A span takes about half a kilobyte.
const QUEUE_MAX: usize = 8192;
/// Maximum number of spans of one message to the collector.
const BATCH_MAX: usize = 512;
/// Time for which a span waits for others.
const GATHER: Duration = Duration::from_millis(500);
/// Time limit for the collector to take a batch.
const EXPORT_WITHIN: Duration = Duration::from_secs(5);
/// Pause after a failed batch; it grows with each further failure, up to the maximum.
const PAUSE_MIN: Duration = Duration::from_secs(1);
const PAUSE_MAX: Duration = Duration::from_secs(30);
/// Time for which the end of the daemon waits for the collector.
const STOP_WITHIN: Duration = Duration::from_secs(2);

fn count_dropped(spans: usize) {
    metrics::counter!("tidemap_spans_dropped_total").increment(spans as u64);
}

/// Receives the spans that end.
#[derive(Debug)]
pub(super) struct Spans(mpsc::Sender<SpanData>);

impl Spans {
    /// Starts the task that sends.
    ///
    /// # Errors
    /// The address cannot be used.
    pub(super) fn start(otlp_endpoint: &str, resource: &Resource) -> anyhow::Result<(Self, Export)> {
        let mut exporter =
            SpanExporter::builder().with_tonic().with_endpoint(otlp_endpoint).with_timeout(EXPORT_WITHIN).build()?;
        exporter.set_resource(resource);
        // The counters exist from the start, so that an alert can distinguish 0 from a missing value.
        count_dropped(0);
        metrics::counter!("tidemap_spans_exported_total").increment(0);
        let (queue, spans) = mpsc::channel(QUEUE_MAX);
        let (stop, stopping) = oneshot::channel();
        let sending = Sending { exporter, spans, failures: 0 };
        Ok((Self(queue), Export { stop, task: tokio::spawn(sending.run(stopping)) }))
    }
}

impl SpanProcessor for Spans {
    fn on_start(&self, _: &mut Span, _: &Context) {}

    fn on_end(&self, span: SpanData) {
        if span.span_context.is_sampled() && self.0.try_send(span).is_err() {
            count_dropped(1);
        }
    }

    fn force_flush(&self) -> OTelSdkResult {
        Ok(())
    }

    fn shutdown_with_timeout(&self, _: Duration) -> OTelSdkResult {
        Ok(())
    }
}

/// The task that sends.
#[derive(Debug)]
pub(super) struct Export {
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Export {
    /// Sends the waiting spans, and ends.
    pub(super) async fn stop(mut self) {
        // An error means that the task has ended.
        let _ = self.stop.send(());
        if timeout(STOP_WITHIN, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }
}

struct Sending {
    exporter: SpanExporter,
    spans: mpsc::Receiver<SpanData>,
    /// Number of failed batches since the last success.
    failures: u32,
}

impl Sending {
    async fn run(mut self, mut stopping: oneshot::Receiver<()>) {
        loop {
            tokio::select! {
                Some(first) = self.spans.recv() => {
                    let mut batch = vec![first];
                    let until = Instant::now() + GATHER;
                    while batch.len() < BATCH_MAX {
                        let room = BATCH_MAX - batch.len();
                        match timeout_at(until, self.spans.recv_many(&mut batch, room)).await {
                            Ok(1..) => {}
                            Ok(0) | Err(_) => break,
                        }
                    }
                    let is_sent = self.send(batch).await;
                    if !is_sent {
                        let pause = PAUSE_MIN.saturating_mul(1 << self.failures.saturating_sub(1).min(5)).min(PAUSE_MAX);
                        tokio::select! {
                            () = sleep(pause) => {}
                            _ = &mut stopping => return self.send_rest().await,
                        }
                    }
                }
                _ = &mut stopping => return self.send_rest().await,
            }
        }
    }

    async fn send_rest(&mut self) {
        let mut batch = Vec::new();
        while let Ok(span) = self.spans.try_recv() {
            batch.push(span);
            if batch.len() == BATCH_MAX && !self.send(std::mem::take(&mut batch)).await {
                return;
            }
        }
        if !batch.is_empty() {
            self.send(batch).await;
        }
    }

    /// Sends a batch; returns whether the collector took it.
    async fn send(&mut self, batch: Vec<SpanData>) -> bool {
        let spans = batch.len();
        let error = match timeout(EXPORT_WITHIN, self.exporter.export(batch)).await {
            Ok(Ok(())) => {
                if self.failures > 0 {
                    info!("spans are sent again");
                }
                self.failures = 0;
                metrics::counter!("tidemap_spans_exported_total").increment(spans as u64);
                return true;
            }
            Ok(Err(error)) => error.to_string(),
            Err(_) => format!("no response within {} seconds", EXPORT_WITHIN.as_secs()),
        };
        if self.failures == 0 {
            warn!(error, "spans cannot be sent to otlp_endpoint: they are dropped and counted until it accepts them");
        }
        self.failures = self.failures.saturating_add(1);
        count_dropped(spans);
        false
    }
}
