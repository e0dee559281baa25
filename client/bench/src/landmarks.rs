//! `tidemap-bench landmarks`.
//!
//! Invariant: every landmark has been in view in every sighting, and every request is for another node and minute, so
//! that no answer is cached.

use std::time::Instant;

use clap::Args;
use tidemap_client::{
    Client,
    landmarks::{Descriptor, ImageFeature, Landmark, LandmarkKind, LocaliseQuery, PartOfEdge, PlaceName},
    maps::{EnabledModels, NewMap},
    observe::{Producer, ProducerOptions, SightingReport},
    routes::{NewNode, StateName},
};
use tidemap_model::time::NANOS_PER_SEC;

use super::{DaemonProcess, Figures, latencies::Latencies, load::scrambled, machine::CpuTimes, updated};
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct LandmarkBenchArgs {
    /// Number of nodes
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(8..=100_000))]
    nodes: u32,
    /// Landmarks of each node
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(8..=4_096))]
    landmarks: u32,
    /// Observations of each node, one a month
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    looks: u32,
    /// Features of an image
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(8..=10_000))]
    features: u32,
    /// Number of requests of each kind
    #[arg(long, value_name = "N", default_value_t = 2_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    requests: u32,
    /// Lets the map choose among all models; without it each landmark has its spectral model only
    #[arg(long)]
    all_models: bool,
    #[command(flatten)]
    process: DaemonProcess,
}

/// Monday 2020-01-06T00:00:00Z.
const START_NANOS: i64 = 1_578_268_800 * NANOS_PER_SEC;
const MINUTE_NANOS: i64 = 60 * NANOS_PER_SEC;
const MONTH_NANOS: i64 = 30 * 24 * 60 * MINUTE_NANOS;
/// Nodes among which a robot is searched.
const NODES_ASKED: u32 = 8;
/// Landmarks that a robot requests.
const LANDMARKS_ASKED: u32 = 100;
const DESCRIPTOR_BYTES: u64 = 32;

impl LandmarkBenchArgs {
    /// The map to create.
    pub(super) fn new_map(&self, name: String) -> NewMap {
        let models = (!self.all_models).then_some(EnabledModels::SPECTRAL);
        NewMap { name, models, ..NewMap::default() }
    }
}

fn node(number: u32) -> String {
    format!("node-{number}")
}

fn feature(node: u32, landmark: u32) -> anyhow::Result<ImageFeature> {
    let seed = u64::from(node) << 20 | u64::from(landmark);
    let bytes: Vec<u8> = (0..DESCRIPTOR_BYTES).map(|byte| scrambled(seed << 6 | byte) as u8).collect();
    let [u_px, v_px] = [1, 2].map(|axis| (scrambled(seed << 2 | axis) % 640) as f64);
    Ok(ImageFeature { u_px, v_px, descriptor: Descriptor::new(&bytes)? })
}

/// Half of the landmarks are seen in half of the months.
fn is_seen(node: u32, landmark: u32, look: u32) -> bool {
    let phase = scrambled(u64::from(node) << 20 | u64::from(landmark)) % 12;
    (u64::from(look) + phase) % 12 < 6
}

/// Creates nodes with landmarks, and sightings of them.
async fn prepare(client: &Client, map: &str, args: &LandmarkBenchArgs) -> anyhow::Result<()> {
    let names = (0..args.nodes).map(|number| Ok(StateName::new(&node(number))?)).collect::<anyhow::Result<Vec<_>>>()?;
    let nodes: Vec<NewNode> =
        names.iter().map(|name| NewNode { name: name.clone(), pose: None, dwell_secs: None }).collect();
    client.load_topology(map, &nodes, &[], false).await?;
    status_line(&format!("adding {} landmarks to map {map}", u64::from(args.nodes) * u64::from(args.landmarks)));
    for (number, name) in (0..).zip(names) {
        let landmark = |landmark: u32| {
            let kind = LandmarkKind::Image(feature(number, landmark)?);
            anyhow::Ok(Landmark { name: StateName::new(&landmark.to_string())?, kind, covariance: None })
        };
        let landmarks = (0..args.landmarks).map(landmark).collect::<anyhow::Result<Vec<_>>>()?;
        client.add_landmarks(map, &PlaceName::Node(name), "bench", &landmarks, None).await?;
    }
    status_line(&format!("sending {} sightings", u64::from(args.nodes) * u64::from(args.looks)));
    let mut producer = Producer::open(client, ProducerOptions::new("bench", "", map)).await?;
    for look in 0..args.looks {
        for number in 0..args.nodes {
            let seen = (0..args.landmarks).filter(|&landmark| is_seen(number, landmark, look));
            let sighting = SightingReport {
                place: node(number),
                time_nanos: START_NANOS + i64::from(look) * MONTH_NANOS + i64::from(number) * MINUTE_NANOS,
                seen: seen.map(|landmark| landmark.to_string()).collect(),
                ..SightingReport::default()
            };
            producer.send_sighting(&sighting).await?;
        }
    }
    producer.close().await?;
    let refused = producer.take_refusals();
    anyhow::ensure!(refused.is_empty(), "the daemon refused {} sightings: {}", refused.len(), refused[0].detail);
    Ok(())
}

pub(super) async fn run(client: &Client, map: &str, args: &LandmarkBenchArgs) -> anyhow::Result<Figures> {
    let began = Instant::now();
    prepare(client, map, args).await?;
    let prepared = began.elapsed();
    let began = Instant::now();
    updated(client, map).await?;
    let updated = began.elapsed();

    status_line("predicting");
    let before = CpuTimes::now(args.process);
    let after_looks = START_NANOS + i64::from(args.looks) * MONTH_NANOS;
    let moment = |number: u32| after_looks + i64::from(number) * MINUTE_NANOS;
    let mut predicted = Latencies::new()?;
    for number in 0..args.requests {
        let requested = (scrambled(number.into()) % u64::from(args.nodes)) as u32;
        let place = PlaceName::parse(&node(requested))?;
        let began = Instant::now();
        let (landmarks, _) =
            client.predict_landmarks(map, (&place, PartOfEdge::WHOLE), moment(number), LANDMARKS_ASKED).await?;
        predicted.record(began.elapsed())?;
        anyhow::ensure!(!landmarks.is_empty(), "the daemon predicted no landmark");
    }
    status_line("localising");
    let (mut localised, mut right) = (Latencies::new()?, 0_u64);
    for number in 0..args.requests {
        let first = (scrambled(number.into()) % u64::from(args.nodes)) as u32;
        let features =
            (0..args.features).map(|landmark| feature(first, landmark)).collect::<anyhow::Result<Vec<_>>>()?;
        let query = LocaliseQuery {
            map: map.to_owned(),
            time_nanos: moment(number),
            features,
            landmarks_per_node: args.landmarks,
            nodes: (0..NODES_ASKED).map(|step| node((first + step) % args.nodes)).collect(),
        };
        let began = Instant::now();
        let found = client.localise(query).await?;
        localised.record(began.elapsed())?;
        right += u64::from(found.first().is_some_and(|best| best.node == node(first)));
    }
    let after = CpuTimes::now(args.process);
    let mut figures = vec![
        ("nodes", args.nodes.into()),
        ("landmarks", args.landmarks.into()),
        ("looks", args.looks.into()),
        ("send_secs", prepared.as_secs_f64().into()),
        ("update_secs", updated.as_secs_f64().into()),
    ];
    figures.extend(predicted.figures(["predict_p50_ms", "predict_p99_ms", "predict_max_ms"]));
    figures.extend(localised.figures(["localise_p50_ms", "localise_p99_ms", "localise_max_ms"]));
    figures.push(("found", (right as f64 / f64::from(args.requests)).into()));
    figures.push(("client_cpu_secs", after.feeder_since(before)));
    figures.push(("daemon_cpu_secs", after.daemon_since(before)));
    Ok(figures)
}
