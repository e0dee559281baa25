//! `tidemap-bench search`.
//!
//! Invariant: the nodes have weeks of periodic observations, and every request is for another minute, so that no answer
//! is cached.

use std::{collections::HashMap, path::PathBuf, time::Instant};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::{
    Client,
    observe::columns::Entry,
    queries::ModelSelector,
    routes::{EdgeEnds, Extent, NewEdge, NewNode, SearchQuery, StateName},
};
use tidemap_formats::topology::read_lines;
use tidemap_model::time::NANOS_PER_SEC;
use tokio::task::JoinSet;

use super::{
    DaemonProcess, Figures,
    latencies::Latencies,
    load::{Load, scrambled},
    machine::CpuTimes,
    updated,
};

use tidemap_cli::{read_text, topology_of_file};
use tidemap_terminal::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct SearchBenchArgs {
    /// Number of nodes, in a tree
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u64).range(2..=1_000))]
    nodes: u64,
    /// A topology in the line format of `topology load`, in place of the tree; its nodes are renamed
    #[arg(long, value_name = "FILE", conflicts_with = "nodes")]
    topology: Option<PathBuf>,
    /// Number of the node where the robot starts, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    start: usize,
    /// Number of requests
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    requests: u32,
    /// Number of concurrent requests
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1_000))]
    concurrent: u32,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    #[command(flatten)]
    process: DaemonProcess,
}

/// Monday 2020-01-06T00:00:00Z.
const START_NANOS: i64 = 1_578_268_800 * NANOS_PER_SEC;
const MINUTE_NANOS: i64 = 60 * NANOS_PER_SEC;
/// Every ten minutes for four weeks.
const READINGS: u64 = 4 * 7 * 144;
const READING_NANOS: i64 = 10 * MINUTE_NANOS;

pub(super) async fn run(client: &Client, map: &str, args: &SearchBenchArgs) -> anyhow::Result<Figures> {
    let (nodes, edges) = match &args.topology {
        Some(path) => {
            let text = read_text(path)?;
            topology_of_file(read_lines(&text).with_context(|| path.display().to_string())?)?
        }
        None => tree(args.nodes)?,
    };
    let states = nodes.len() as u64;
    anyhow::ensure!(args.start < nodes.len(), "--start is {}, of {states} nodes", args.start);
    let load = Load {
        map: map.to_owned(),
        streams: 4,
        states,
        name_chars: 16,
        observations: states * READINGS,
        batch: 4096,
        observation,
    };
    let (nodes, edges) = renamed(nodes, edges, &load)?;
    client.load_topology(map, &nodes, &edges, false).await?;
    status_line(&format!("sending four weeks of {states} nodes to map {map}"));
    load.send(client).await?;
    updated(client, map).await?;

    let future = START_NANOS + 5 * 7 * 24 * 60 * MINUTE_NANOS;
    let query = |number: u32| SearchQuery {
        map: map.to_owned(),
        start: nodes[args.start].name.to_string(),
        time_nanos: future + i64::from(number) * MINUTE_NANOS,
        model: args.model,
        ..SearchQuery::default()
    };
    status_line("searching");
    // Warm up: some results are computed once.
    for number in 0..100 {
        client.plan_search(query(number)).await?;
    }
    let before = CpuTimes::now(args.process);
    let began = Instant::now();
    let mut running = JoinSet::new();
    for first in 0..args.concurrent {
        let queries: Vec<SearchQuery> = (first..args.requests).step_by(args.concurrent as usize).map(query).collect();
        running.spawn(request(client.clone(), queries));
    }
    let mut answers = Latencies::new()?;
    while let Some(one) = running.join_next().await {
        answers.add(one??)?;
    }
    let elapsed = began.elapsed();
    let after = CpuTimes::now(args.process);
    let mut figures = vec![
        ("nodes", states.into()),
        ("concurrent", args.concurrent.into()),
        ("searches", answers.count().into()),
        ("searches_per_sec", (answers.count() as f64 / elapsed.as_secs_f64()).round().into()),
    ];
    figures.extend(answers.figures(["p50_ms", "p99_ms", "max_ms"]));
    figures.push(("client_cpu_secs", after.feeder_since(before)));
    figures.push(("daemon_cpu_secs", after.daemon_since(before)));
    Ok(figures)
}

/// Sends the requests one after another, and measures their latencies.
async fn request(client: Client, queries: Vec<SearchQuery>) -> anyhow::Result<Latencies> {
    let mut answers = Latencies::new()?;
    for query in queries {
        let began = Instant::now();
        let search = client.plan_search(query).await?;
        let took = began.elapsed();
        anyhow::ensure!(!search.steps.is_empty(), "the daemon planned a search without steps");
        answers.record(took)?;
    }
    Ok(answers)
}

/// Nodes and edges to load.
type NewTopology = (Vec<NewNode>, Vec<NewEdge>);

/// A tree with three branches per node, of 10 to 26 s each.
fn tree(nodes: u64) -> anyhow::Result<NewTopology> {
    let name = |number: u64| StateName::new(&number.to_string());
    let node = |number: u64| Ok(NewNode { name: name(number)?, pose: None, dwell_secs: None });
    let edge = |number: u64| {
        let extent = Extent::secs(10.0 + (scrambled(number) % 17) as f64);
        Ok(NewEdge { ends: EdgeEnds::link(name((number - 1) / 3)?, name(number)?), extent })
    };
    let nodes_of = (0..nodes).map(node).collect::<anyhow::Result<_>>()?;
    Ok((nodes_of, (1..nodes).map(edge).collect::<anyhow::Result<_>>()?))
}

/// The given nodes and edges, with nodes named like the states of the load.
fn renamed(mut nodes: Vec<NewNode>, mut edges: Vec<NewEdge>, load: &Load) -> anyhow::Result<NewTopology> {
    let numbers: HashMap<StateName, u64> = nodes.iter().map(|node| node.name.clone()).zip(0..).collect();
    let renamed = |name: &StateName| {
        let number = numbers.get(name).with_context(|| format!("there is no node {:?}", name.as_str()))?;
        anyhow::Ok(StateName::new(&load.name(*number))?)
    };
    for node in &mut nodes {
        node.name = renamed(&node.name)?;
    }
    for NewEdge { ends, .. } in &mut edges {
        (ends.from, ends.to) = (renamed(&ends.from)?, renamed(&ends.to)?);
    }
    Ok((nodes, edges))
}

/// A target with a daily routine and exceptions: the state of a node is 1 while the target is there.
fn observation(load: &Load, number: u64) -> Entry {
    let (state, reading) = (number % load.states, number / load.states);
    let (hour, day) = (reading % 144 / 6, reading / 144 % 7);
    let usual = (hour / 2 + if day < 5 { 0 } else { 1 }) % load.states;
    let unusual = scrambled(reading / 3) % load.states;
    let place = if scrambled(reading).is_multiple_of(5) { unusual } else { usual };
    let offset = i64::try_from(state).unwrap_or(0) * 1_000_000;
    Entry {
        state: u32::try_from(state).unwrap_or(0),
        time_nanos: START_NANOS + i64::try_from(reading).unwrap_or(0) * READING_NANOS + offset,
        value: f64::from(u8::from(place == state)),
        position: None,
    }
}
