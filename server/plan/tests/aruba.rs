//! Where to look for the person of the Aruba flat (Waldo, section VII): how long it takes, by what is known of her habits.
//! Skipped where the recordings are not at hand.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use tidemap_map::{
    name::StateName,
    topology::{Extent, NodeId, Roads, Topology},
};
use tidemap_model::{Accumulator, Periodicities, Sample, SpectralModel};
use tidemap_plan::search::{Goal, Options, search};

const MINUTE_NANOS: i64 = 60_000_000_000;
const WEEK: usize = 7 * 1440;

fn recordings() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join("aruba");
    if !folder.is_dir() {
        println!("SKIPPED: no recordings at {}", folder.display());
        return None;
    }
    Some(folder)
}

/// The flat and, by minute, the room that she is in; `None` while nobody is at home.
struct Flat {
    topology: Topology,
    rooms: Vec<Option<NodeId>>,
}

impl Flat {
    fn read(folder: &Path) -> Flat {
        let mut topology = Topology::new();
        for line in std::fs::read_to_string(folder.join("topology.txt")).unwrap().lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                ["node", name] => drop(topology.add_node(StateName::new(name).unwrap(), None, None).unwrap()),
                ["link", a, b, secs] => {
                    let (a, b) = (topology.node_named(a).unwrap().id, topology.node_named(b).unwrap().id);
                    topology.link(a, b, Extent::secs(secs.parse().unwrap())).unwrap();
                }
                _ => assert!(words.is_empty(), "{line}"),
            }
        }
        let mut rooms = Vec::new();
        for line in std::fs::read_to_string(folder.join("presence_8weeks.txt")).unwrap().lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [from, to, room] = words[..] else { panic!("{line}") };
            assert_eq!(from.parse::<usize>().unwrap(), rooms.len());
            rooms.resize(to.parse().unwrap(), topology.node_named(room).ok().map(|node| node.id));
        }
        assert_eq!(rooms.len(), 8 * WEEK);
        Flat { topology, rooms }
    }

    fn nodes(&self) -> Vec<NodeId> {
        self.topology.nodes().map(|node| node.id).collect()
    }

    /// Mean and median, over the minutes of the last four weeks with somebody at home, of the time after which she is found.
    fn search(&self, probability: impl Fn(NodeId, usize) -> f64, what: &str) -> (f64, f64) {
        let roads = Roads::new(&self.topology, |edge| edge.extent.nominal_secs).unwrap();
        let (start, nodes) = (self.topology.node_named("Center").unwrap().id, self.nodes());
        let mut found = Vec::new();
        for minute in 4 * WEEK..8 * WEEK {
            let Some(room) = self.rooms[minute] else { continue };
            let goal = |&node: &NodeId| Goal { node, probability: probability(node, minute).clamp(0.0, 1.0) };
            let goals: Vec<Goal> = nodes.iter().map(goal).collect();
            let plan = search(&roads, start, &goals, &Options::default(), || false).unwrap();
            assert!(plan.optimal);
            found.push(plan.steps.iter().find(|step| step.node == room).unwrap().arrival_secs);
        }
        found.sort_by(f64::total_cmp);
        let (mean, median) = (found.iter().sum::<f64>() / found.len() as f64, found[found.len() / 2]);
        println!("{what}: mean {mean:.2} s, median {median} s of {} searches", found.len());
        (mean, median)
    }
}

fn is_near(found: (f64, f64), mean: f64, median: f64) -> bool {
    (found.0 - mean).abs() < 0.6 && found.1 == median
}

#[test]
fn who_knows_her_share_of_time_in_each_room_takes_47_seconds() {
    let Some(folder) = recordings() else { return };
    let flat = Flat::read(&folder);
    let share = |node| flat.rooms[..4 * WEEK].iter().filter(|&&room| room == Some(node)).count() as f64;
    let shares: Vec<f64> = flat.nodes().into_iter().map(|node| share(node) / (4 * WEEK) as f64).collect();
    let static_secs = flat.search(|node, _| shares[node.0 as usize], "static");
    assert!(is_near(static_secs, 47.2, 43.0), "{static_secs:?}");
}

#[test]
fn who_knows_where_she_is_takes_17_seconds() {
    let Some(folder) = recordings() else { return };
    let flat = Flat::read(&folder);
    let omniscient = |node, minute: usize| f64::from(u8::from(flat.rooms[minute] == Some(node)));
    let omniscient_secs = flat.search(omniscient, "omniscient");
    assert!(is_near(omniscient_secs, 17.2, 15.0), "{omniscient_secs:?}");
}

#[test]
fn who_knows_her_rhythm_takes_37_seconds() {
    let Some(folder) = recordings() else { return };
    let flat = Flat::read(&folder);
    let periodicities = Periodicities::default();
    let models: Vec<SpectralModel> = flat
        .nodes()
        .into_iter()
        .map(|node| {
            let sample = |(minute, room): (usize, &Option<NodeId>)| Sample {
                utc_nanos: minute as i64 * MINUTE_NANOS,
                offset_secs: 0,
                value: f64::from(u8::from(*room == Some(node))),
            };
            let samples: Vec<Sample> = flat.rooms[..4 * WEEK].iter().enumerate().map(sample).collect();
            let mut accumulator = Accumulator::new(&periodicities);
            accumulator.add(&periodicities, &samples);
            SpectralModel::fit(&accumulator, &periodicities)
        })
        .collect();
    let rhythm =
        |node: NodeId, minute: usize| models[node.0 as usize].predict(&periodicities, 2, minute as i64 * MINUTE_NANOS);
    let rhythm_secs = flat.search(rhythm, "FreMEn of order 2");
    assert!(is_near(rhythm_secs, 36.6, 15.0), "{rhythm_secs:?}");
}
