//! Small random maps with forecasts that change over time.

use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_map::{
    name::StateName,
    topology::{Edge, Extent, Topology},
};

use super::*;

/// A map with forecasts of its edges: a periodic table by edge and stretch of time.
#[derive(Clone, Debug)]
pub(crate) struct World {
    pub(crate) topology: Topology,
    pub(crate) stretch_secs: f64,
    pub(crate) forecasts: Vec<Vec<Option<EdgeForecast>>>,
}

impl World {
    /// Creates up to eight nodes, some parallel edges, some closed at times. Whole numbers make ties.
    pub(crate) fn random(seed: u64) -> World {
        let mut random = SmallRng::seed_from_u64(seed);
        let count = random.random_range(2..=8);
        let whole = seed.is_multiple_of(3);
        let mut topology = Topology::new();
        let nodes: Vec<NodeId> = (0..count)
            .map(|node| topology.add_node(StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap())
            .collect();
        for _ in 0..random.random_range(count..4 * count) {
            let (from, to) = (random.random_range(0..count), random.random_range(0..count));
            let action = random.random_bool(0.2).then(|| StateName::new("door").unwrap());
            // Existing edges and loops are omitted.
            let _ = topology.add_edge(nodes[from], nodes[to], action, Extent::secs(1.0));
        }
        let stretches = random.random_range(1..6);
        let closed = if random.random_bool(0.5) { 0.2 } else { 0.0 };
        let mut forecast = || {
            let success = match whole {
                true => [1.0, 0.5, 0.25][random.random_range(0..3)],
                false => random.random_range(0.05..=1.0),
            };
            let duration_secs =
                if whole { f64::from(random.random_range(1..4_u8)) * 10.0 } else { random.random_range(0.5..60.0) };
            let forecast = EdgeForecast { success, duration_secs, evidence: random.random_range(0.5..50.0) };
            (!random.random_bool(closed)).then_some(forecast)
        };
        let forecasts = topology.edges().map(|_| (0..stretches).map(|_| forecast()).collect()).collect();
        World { topology, stretch_secs: random.random_range(5.0..50.0), forecasts }
    }

    pub(crate) fn at(&self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        let stretches = &self.forecasts[edge.id.0 as usize];
        stretches[(at_secs / self.stretch_secs).floor().rem_euclid(stretches.len() as f64) as usize]
    }
}

/// Forecasts with bounds.
pub(crate) struct Knowing<'a>(pub(crate) &'a World);

impl Forecasts for Knowing<'_> {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        self.0.at(edge, at_secs)
    }

    fn best(&mut self, edge: &Edge, _from_secs: f64, _to_secs: f64) -> Option<EdgeBest> {
        let known = || self.0.forecasts[edge.id.0 as usize].iter().flatten();
        let success = known().map(|forecast| forecast.success).reduce(f64::max)?;
        let duration_secs = known().map(|forecast| forecast.duration_secs).reduce(f64::min)?;
        Some(EdgeBest { success, duration_secs })
    }
}
