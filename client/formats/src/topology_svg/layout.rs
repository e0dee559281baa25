//! Where nodes are drawn whose place is not known: near ones near each other.
//!
//! The distances of the drawing are brought as near as they can be to the shortest ways along edges, by majorising the sum of
//! their squared differences (stress majorisation; Gansner, Koren, North: Graph drawing by stress majorization, GD 2004).
//! Invariant: no chance is in it; nodes between which there is no way are apart.

use std::f64::consts::TAU;

use super::{DrawnEdge, DrawnNode, TopologyPictureError};

/// Most nodes that are laid out.
pub const LAID_OUT_MAX: usize = 400;
const ROUNDS: usize = 200;

/// Where each node lies: as the map says, or laid out where it does not say of all.
pub fn places(nodes: &[DrawnNode], edges: &[DrawnEdge]) -> Result<Vec<[f64; 2]>, TopologyPictureError> {
    if nodes.is_empty() {
        return Err(TopologyPictureError::Empty);
    }
    if let Some(known) = nodes.iter().map(|node| node.at_m).collect::<Option<Vec<_>>>() {
        return Ok(known);
    }
    let count = nodes.len();
    if count > LAID_OUT_MAX {
        let without = nodes.iter().filter(|node| node.at_m.is_none()).count();
        return Err(TopologyPictureError::TooMany { without, nodes: count });
    }
    let far = distances(count, edges);
    let mut places: Vec<[f64; 2]> = (0..count)
        .map(|node| {
            let (sin, cos) = (node as f64 / count as f64 * TAU).sin_cos();
            [cos, sin]
        })
        .collect();
    for _ in 0..ROUNDS {
        let before = places.clone();
        for (node, place) in places.iter_mut().enumerate() {
            let (mut sum, mut weights) = ([0.0, 0.0], 0.0);
            for (other, at) in before.iter().enumerate().filter(|&(other, _)| other != node) {
                let wanted = far[node * count + other];
                let weight = 1.0 / (wanted * wanted);
                let apart = [before[node][0] - at[0], before[node][1] - at[1]];
                let stretch = wanted / apart[0].hypot(apart[1]).max(1e-9);
                for axis in 0..2 {
                    sum[axis] += weight * (at[axis] + apart[axis] * stretch);
                }
                weights += weight;
            }
            if weights > 0.0 {
                *place = sum.map(|sum| sum / weights);
            }
        }
    }
    Ok(places)
}

/// Shortest ways between all nodes, whichever direction, over their mean edge; those without a way are a little farther apart
/// than the farthest.
fn distances(count: usize, edges: &[DrawnEdge]) -> Vec<f64> {
    let is_told = |edge: &&DrawnEdge| edge.length > 0.0 && edge.length.is_finite();
    let told: Vec<f64> = edges.iter().filter(is_told).map(|edge| edge.length).collect();
    let mean = if told.is_empty() { 1.0 } else { told.iter().sum::<f64>() / told.len() as f64 };
    let mut far = vec![f64::INFINITY; count * count];
    for edge in edges.iter().filter(|edge| edge.from < count && edge.to < count && edge.from != edge.to) {
        // A way much shorter than others would put two discs over each other.
        let length = if is_told(&edge) { (edge.length / mean).clamp(0.5, 5.0) } else { 1.0 };
        for (from, to) in [(edge.from, edge.to), (edge.to, edge.from)] {
            far[from * count + to] = far[from * count + to].min(length);
        }
    }
    for over in 0..count {
        for from in 0..count {
            let first = far[from * count + over];
            if first.is_finite() {
                for to in 0..count {
                    let way = first + far[over * count + to];
                    if way < far[from * count + to] {
                        far[from * count + to] = way;
                    }
                }
            }
        }
    }
    let farthest = far.iter().copied().filter(|way| way.is_finite()).fold(1.0, f64::max);
    far.iter_mut().filter(|way| !way.is_finite()).for_each(|way| *way = 1.2 * farthest);
    far
}
