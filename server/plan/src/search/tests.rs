//! Searches against naive oracles, and what is refused.

mod bounds;
#[path = "../../benches/search/maps.rs"]
mod maps;
mod optimal;
mod plans;

use self::maps::Map;
use super::*;

fn goals(map: &Map) -> Vec<Goal> {
    map.goals.iter().map(|&(node, probability)| Goal { node, probability }).collect()
}
