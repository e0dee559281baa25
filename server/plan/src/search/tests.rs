//! Searches against naive oracles, and refused input.

mod bounds;
mod optimal;
mod plans;

use rand::{Rng, SeedableRng, rngs::SmallRng};

use super::{
    problem::{Passing, SearchProblem},
    *,
};
use crate::testkit::{Map, Shape};

const SHAPES: [Shape; 4] = [Shape::Tree, Shape::Streets, Shape::Complete, Shape::Random];

fn goals(map: &Map) -> Vec<Goal> {
    map.goals.iter().map(|&(node, probability)| Goal { node, probability }).collect()
}

/// The given map, with dwell times at about half of its nodes.
fn with_looks(mut map: Map, seed: u64) -> Map {
    let mut random = SmallRng::seed_from_u64(seed);
    for &(node, _) in &map.goals {
        if random.random() {
            map.topology.set_node(node, None, Some(f64::from(random.random_range(1..20_u8)))).unwrap();
        }
    }
    map
}
