//! All answers of a daemon, bit by bit, so that two daemons can be compared.
//!
//! Invariant: reads only; an error is also an answer.

use std::fmt::Write as _;

use tidemap_client::{
    Client,
    landmarks::PartOfEdge,
    queries::{Blend, ModelKind, ModelSelector},
    tasks::LocalDay,
};

use crate::{
    daemon::Daemon,
    stream::{RawStream, hello},
};

/// Times at which every state is predicted: within the observations, and long after.
const TIMES_NANOS: [i64; 4] =
    [1_614_600_000_000_000_000, 1_614_700_000_123_456_789, 1_615_500_000_000_000_000, 1_900_000_000_000_000_000];

/// All maps with their states, models and predictions, and the durable sequence number of each named producer. One fact
/// a line, numbers as their bits.
///
/// # Panics
/// If the daemon does not answer at all.
pub async fn all(daemon: &Daemon, producers: &[String]) -> Vec<String> {
    let client = daemon.client();
    let mut lines = Vec::new();
    for map in client.maps().await.expect("the daemon responds") {
        lines.push(format!("{map:?}"));
        let name = map.name.clone();
        for producer in producers {
            let text = match RawStream::open(&daemon.grpc, hello(producer, &name)).await {
                Ok((mut stream, welcome)) => {
                    stream.close();
                    stream.end().await;
                    format!("{} {:08x} {}", welcome.durable_sequence, welcome.content_crc, welcome.store_id)
                }
                Err(ended) => format!("{ended:?}"),
            };
            lines.push(format!("{name} {producer}: {text}"));
        }
        let (states, _) = client.states(&name, "").await.expect("the map is there");
        for state in states {
            lines.push(format!("{name} {state:?}"));
            lines.push(model(&client, &name, &state.name).await);
            lines.push(predictions(&client, &name, &state.name).await);
        }
        lines.push(format!("{name}: {:?}", client.tasks(&name).await));
        lines.extend(plans(&client, &name).await);
        lines.extend(landmarks(&client, &name).await);
    }
    lines
}

/// The kept plans of the spring of the feeds.
async fn plans(client: &Client, map: &str) -> Vec<String> {
    let mut lines = Vec::new();
    for day in 0..62 {
        let date = LocalDay::of_civil_nanos((18_687 + day) * 86_400_000_000_000).to_string();
        let kept = client.kept_plan(map, Some(&date), None).await;
        lines.extend(kept.ok().map(|(plan, _)| format!("{map} {date}: {plan:?}")));
    }
    lines
}

async fn landmarks(client: &Client, map: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let places = client.landmark_places(map).await.expect("the map is there").0;
    for (place, count) in places {
        lines.push(format!("{map} {place} {count}: {:?}", client.landmarks(map, &place, PartOfEdge::WHOLE).await));
    }
    lines
}

async fn model(client: &Client, map: &str, state: &str) -> String {
    let model = match client.describe_model(map, state).await {
        Ok(model) => model,
        Err(error) => return format!("{map} {state}: {error}"),
    };
    let mut text =
        format!("{map} {state}: {model:?} {:x} {:x}", model.mean.to_bits(), model.persistence_tau_secs.to_bits());
    for component in &model.components {
        let bits = [component.period_secs, component.amplitude, component.phase_rad].map(f64::to_bits);
        let _ = write!(text, " {bits:x?}");
    }
    for error in &model.order_errors {
        let _ = write!(text, " {:x}", error.to_bits());
    }
    text
}

async fn predictions(client: &Client, map: &str, state: &str) -> String {
    let mut text = format!("{map} {state}:");
    // The other models are trained on history, which is read only on demand, so its damage is reported only then.
    for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Latest, ModelKind::Spectral] {
        for blend in [Blend::None, Blend::Persistence] {
            let model = ModelSelector { kind, blend, ..ModelSelector::default() };
            let mut runs = client.predict(map, vec![state.to_owned()], TIMES_NANOS.to_vec(), model);
            let _ = write!(text, " {model}");
            match runs.next().await {
                Ok(Some(run)) => {
                    let bits: Vec<u64> = run.probabilities.iter().map(|p| p.to_bits()).collect();
                    let _ = write!(text, " {bits:x?} {} {} {:?}", run.order, run.observations, run.last_nanos);
                }
                other => {
                    let _ = write!(text, " {other:?}");
                }
            }
        }
    }
    text
}
