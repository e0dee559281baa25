//! The layout of nodes without positions: connected nodes are close to each other.
//!
//! The distances in the drawing approach the lengths of the shortest paths along edges, by majorising the sum of their
//! squared differences (stress majorisation; Gansner, Koren, North: Graph drawing by stress majorization, GD 2004).
//! Invariant: deterministic; unconnected nodes do not overlap.

use std::f64::consts::TAU;

use super::{PictureEdge, PictureNode, TopologyPictureError};

/// Maximum number of nodes that are laid out.
pub const LAYOUT_NODES_MAX: usize = 400;
const ROUNDS: usize = 200;

/// The positions of the map if every node has one, otherwise a layout.
pub(super) fn places(nodes: &[PictureNode], edges: &[PictureEdge]) -> Result<Vec<[f64; 2]>, TopologyPictureError> {
    if nodes.is_empty() {
        return Err(TopologyPictureError::Empty);
    }
    if let Some(known) = nodes.iter().map(|node| node.at_m).collect::<Option<Vec<_>>>() {
        return Ok(known);
    }
    let count = nodes.len();
    if count > LAYOUT_NODES_MAX {
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
                let ideal = far[node * count + other];
                let weight = 1.0 / (ideal * ideal);
                let apart = [before[node][0] - at[0], before[node][1] - at[1]];
                let stretch = ideal / apart[0].hypot(apart[1]).max(1e-9);
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

/// Lengths of the shortest paths between all nodes in either direction, divided by the mean length of an edge.
/// Unconnected nodes get 1.2 times the largest length.
fn distances(count: usize, edges: &[PictureEdge]) -> Vec<f64> {
    let has_length = |edge: &&PictureEdge| edge.length > 0.0 && edge.length.is_finite();
    let lengths: Vec<f64> = edges.iter().filter(has_length).map(|edge| edge.length).collect();
    let mean = if lengths.is_empty() { 1.0 } else { lengths.iter().sum::<f64>() / lengths.len() as f64 };
    let mut far = vec![f64::INFINITY; count * count];
    for edge in edges.iter().filter(|edge| edge.from < count && edge.to < count && edge.from != edge.to) {
        // An edge much shorter than the others would make two discs overlap.
        let length = if has_length(&edge) { (edge.length / mean).clamp(0.5, 5.0) } else { 1.0 };
        for (from, to) in [(edge.from, edge.to), (edge.to, edge.from)] {
            far[from * count + to] = far[from * count + to].min(length);
        }
    }
    for over in 0..count {
        for from in 0..count {
            let first = far[from * count + over];
            if first.is_finite() {
                for to in 0..count {
                    let path = first + far[over * count + to];
                    if path < far[from * count + to] {
                        far[from * count + to] = path;
                    }
                }
            }
        }
    }
    let farthest = far.iter().copied().filter(|path| path.is_finite()).fold(1.0, f64::max);
    far.iter_mut().filter(|path| !path.is_finite()).for_each(|path| *path = 1.2 * farthest);
    far
}
