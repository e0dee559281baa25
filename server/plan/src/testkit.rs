//! Random maps to search, for benchmarks and tests.
#![allow(clippy::unwrap_used)]

use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_map::{
    name::StateName,
    topology::{Extent, NodeId, Roads, Topology},
};

/// Kinds of maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// Each node is connected to an earlier one.
    Tree,
    /// A grid of streets of which a third is closed; it stays connected.
    Streets,
    /// Edges between all nodes, with the distances of points in a square.
    Complete,
    /// A tree with additional edges, which differ by direction.
    Random,
}

/// A map with the goals of a search from node 0.
#[derive(Clone, Debug)]
pub(crate) struct Map {
    pub(crate) topology: Topology,
    /// Nodes with probabilities.
    pub(crate) goals: Vec<(NodeId, f64)>,
}

impl Map {
    /// The node at which the search begins.
    pub(crate) fn start(&self) -> NodeId {
        NodeId(0)
    }

    /// The map with its nominal times.
    pub(crate) fn roads(&self) -> Roads {
        Roads::new(&self.topology, |edge| Some(edge.extent.secs_at(1.0))).unwrap()
    }

    /// A map of the given number of nodes. Whole times and weights have many ties.
    pub(crate) fn random(shape: Shape, count: usize, whole: bool, seed: u64) -> Map {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut topology = Topology::new();
        let nodes: Vec<NodeId> = (0..count)
            .map(|node| topology.add_node(StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap())
            .collect();
        let places: Vec<(f64, f64)> =
            (0..count).map(|_| (random.random_range(0.0..100.0), random.random_range(0.0..100.0))).collect();
        let rounded = |secs: f64| if whole { secs.ceil().max(1.0) } else { secs.max(1e-3) };
        let mut link = |a: usize, b: usize, secs: f64| topology.link(nodes[a], nodes[b], Extent::secs(rounded(secs)));
        match shape {
            Shape::Tree => {
                for node in 1..count {
                    let secs = random.random_range(1.0..10.0);
                    link(random.random_range(0..node), node, secs).unwrap();
                }
            }
            Shape::Streets => {
                let width = (count as f64).sqrt().ceil() as usize;
                for node in 1..count {
                    let (left, up) = (node % width > 0, node >= width);
                    let both = left && up && random.random_range(0..3) > 0;
                    let secs = random.random_range(5.0..15.0);
                    if left && (both || !up || random.random()) {
                        link(node - 1, node, secs).unwrap();
                        if both {
                            link(node - width, node, secs + 1.0).unwrap();
                        }
                    } else {
                        link(node - width, node, secs).unwrap();
                    }
                }
            }
            Shape::Complete => {
                for a in 0..count {
                    for b in a + 1..count {
                        let secs = (places[a].0 - places[b].0).hypot(places[a].1 - places[b].1);
                        link(a, b, secs).unwrap();
                    }
                }
            }
            Shape::Random => {
                for node in 1..count {
                    link(random.random_range(0..node), node, random.random_range(1.0..20.0)).unwrap();
                }
                for _ in 0..count {
                    let (from, to) = (random.random_range(0..count), random.random_range(0..count));
                    let extent = Extent::secs(rounded(random.random_range(1.0..20.0)));
                    // Existing edges and loops are omitted.
                    let _ = topology.add_edge(nodes[from], nodes[to], None, extent);
                }
            }
        }
        let mut probability = || match whole {
            true => f64::from(random.random_range(0..5_u8)) / 10.0,
            false if random.random_range(0..8) == 0 => 0.0,
            false => random.random(),
        };
        let goals = nodes.iter().map(|&node| (node, probability())).collect();
        Map { topology, goals }
    }
}

/// A chain of nodes, connected both ways, with equal edges of 10 s.
pub(crate) fn street(count: usize) -> Topology {
    let mut topology = Topology::new();
    let nodes: Vec<NodeId> = (0..count)
        .map(|node| topology.add_node(StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap())
        .collect();
    for pair in nodes.windows(2) {
        topology.link(pair[0], pair[1], Extent::secs(10.0)).unwrap();
    }
    topology
}
