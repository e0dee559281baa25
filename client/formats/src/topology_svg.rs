//! A topological map at a time as SVG: where the person is likely to be, which edges are likely passable, and a route
//! or a search.
//!
//! Nodes are drawn at their positions in the map; if any node has none, all are laid out so that connected nodes are
//! close to each other. Nodes and edges with an unknown probability are grey.
//! A name stands on the side of its node where no edge leaves, and the number of an edge beside it.
//! Invariant: the same map gives the same bytes; y points upwards as in the map.

use std::collections::HashMap;

use tidemap_picture::palette::{is_dark, mark};

use crate::svg::{Svg, hex};

mod layout;
mod legend;
#[cfg(test)]
mod tests;

pub use layout::LAYOUT_NODES_MAX;

/// Pixels of the drawing's longer side, without its margin.
const SIDE: f64 = 900.0;
/// Pixels around the drawing.
const MARGIN: f64 = 70.0;
/// Pixels of a node's radius.
const DISC: f64 = 15.0;
/// Pixels between the centre line and each of the two directions of a link.
const APART: f64 = 3.0;
/// The colour of anything unknown.
const GREY: &str = "#9a9a9a";
/// The colour of the path of a route or a search.
const PATH: &str = "#1a4fa3";
const MIDDLE: &str = "text-anchor=\"middle\"";
/// Text on a dark node.
const WHITE: &str = " fill=\"#ffffff\"";
/// Pixels between an edge and the middle of its number.
const BESIDE: f64 = 10.0;
/// A white edge around a text that must cross a line.
const HALO: &str = "stroke=\"#ffffff\" stroke-width=\"3\" paint-order=\"stroke\"";

/// A node of a drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PictureNode {
    /// Text beside the node.
    pub name: String,
    /// Position in metres; none: laid out by the drawing.
    pub at_m: Option<[f64; 2]>,
    /// Probability that the person is there.
    pub probability: Option<f64>,
    /// Position in the order of a search or a route, from 1.
    pub step: Option<usize>,
}

/// A directed edge of a drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PictureEdge {
    /// Index of the start node.
    pub from: usize,
    /// Index of the end node.
    pub to: usize,
    /// Length in any unit; used by the layout only.
    pub length: f64,
    /// Probability of a successful traversal.
    pub success: Option<f64>,
    /// Whether the edge is part of the route or search.
    pub is_on_path: bool,
}

/// A topological map to draw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyPicture {
    /// A line above the drawing.
    pub title: String,
    /// The nodes; edges name them by index.
    pub nodes: Vec<PictureNode>,
    /// The edges, one for each direction.
    pub edges: Vec<PictureEdge>,
}

/// Why a map cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum TopologyPictureError {
    /// No nodes.
    #[error("the map has no nodes: there is nothing to draw")]
    Empty,
    /// Too many nodes to lay out.
    #[error(
        "{without} of {nodes} nodes have no position, and only maps of up to {LAYOUT_NODES_MAX} nodes are laid out: give \
         positions with `tidemap topology edit set-node --position`"
    )]
    TooMany { without: usize, nodes: usize },
}

/// Draws a map.
///
/// # Errors
/// [`TopologyPictureError`].
pub fn write(picture: &TopologyPicture) -> Result<String, TopologyPictureError> {
    let (places, scale) = scaled(&layout::places(&picture.nodes, &picture.edges)?);
    let far = |axis: usize| places.iter().map(|place| place[axis]).fold(0.0, f64::max) + MARGIN;
    let mut svg = Svg::new([far(0).max(legend::WIDTH), far(1) + legend::HEIGHT], 12.0);
    let has_path = picture.edges.iter().any(|edge| edge.is_on_path) || picture.nodes.iter().any(|n| n.step.is_some());
    let is_in_metres = picture.nodes.iter().all(|node| node.at_m.is_some());
    legend::draw(&mut svg, far(1) + 14.0, has_path, Some(scale).filter(|_| is_in_metres));
    svg.text([12.0, 22.0], &picture.title, "font-size=\"15\"");
    draw_edges(&mut svg, &picture.edges, &places);
    for (index, (node, &[x, y])) in picture.nodes.iter().zip(&places).enumerate() {
        let fill = node.probability.map_or_else(|| GREY.to_owned(), presence_colour);
        let line = if node.step.is_some() { PATH } else { "#404040" };
        svg.circle([x, y], DISC, &format!("fill=\"{fill}\" stroke=\"{line}\" stroke-width=\"2\""));
        let (inside, below) = match (node.step, node.probability.map(percent)) {
            (Some(step), Some(percent)) => (step.to_string(), format!("{} {percent}%", node.name)),
            (Some(step), None) => (step.to_string(), node.name.clone()),
            (None, percent) => (percent.unwrap_or_default(), node.name.clone()),
        };
        let ink = if node.probability.is_some_and(|probability| is_dark(mark(probability))) { WHITE } else { "" };
        svg.text([x, y + 4.0], &inside, &format!("{MIDDLE}{ink}"));
        let ([dx, dy], anchor) = free_side(index, &picture.edges, &places);
        svg.text([x + dx, y + dy], &below, &format!("text-anchor=\"{anchor}\" {HALO}"));
    }
    Ok(svg.finish())
}

/// The side of a node that is farthest from the directions of its edges, below if possible: the place of its name, from
/// the middle of the node, and the text anchor.
fn free_side(node: usize, edges: &[PictureEdge], places: &[[f64; 2]]) -> ([f64; 2], &'static str) {
    const SIDES: [([f64; 2], [f64; 2], &str); 4] = [
        ([0.0, 1.0], [0.0, DISC + 14.0], "middle"),
        ([0.0, -1.0], [0.0, -DISC - 5.0], "middle"),
        ([1.0, 0.0], [DISC + 5.0, 4.0], "start"),
        ([-1.0, 0.0], [-DISC - 5.0, 4.0], "end"),
    ];
    // The greatest cosine of the angle to an edge: -1 is free.
    let closeness = |side: [f64; 2]| {
        let others = edges.iter().filter_map(|edge| match (edge.from == node, edge.to == node) {
            (true, false) => places.get(edge.to),
            (false, true) => places.get(edge.from),
            _ => None,
        });
        let cosine = |other: &[f64; 2]| {
            let [x, y] = [other[0] - places[node][0], other[1] - places[node][1]];
            (x * side[0] + y * side[1]) / x.hypot(y).max(1e-9)
        };
        others.map(cosine).fold(-1.0, f64::max)
    };
    let mut best = (f64::INFINITY, SIDES[0]);
    for side in SIDES {
        let found = closeness(side.0);
        // An angle of 45 degrees leaves enough room: the first such side is taken.
        let found = if found < 0.71 { -1.0 } else { found };
        if found < best.0 - 1e-6 {
            best = (found, side);
        }
    }
    (best.1.1, best.1.2)
}

/// Draws both directions of a link side by side, each with its probability of success in percent where it is known.
fn draw_edges(svg: &mut Svg, edges: &[PictureEdge], places: &[[f64; 2]]) {
    let link = |edge: &PictureEdge| (edge.from.min(edge.to), edge.from.max(edge.to));
    let mut directions: HashMap<(usize, usize), u32> = HashMap::new();
    for edge in edges {
        *directions.entry(link(edge)).or_default() += 1;
    }
    for edge in edges {
        let (Some(&[ax, ay]), Some(&[bx, by])) = (places.get(edge.from), places.get(edge.to)) else { continue };
        let (along, across) = (bx - ax, by - ay);
        let length = along.hypot(across).max(1e-9);
        let aside = if directions.get(&link(edge)) == Some(&1) { 0.0 } else { APART };
        let (dx, dy) = (-across / length * aside, along / length * aside);
        let colour = match edge.success {
            _ if edge.is_on_path => PATH.to_owned(),
            Some(success) => success_colour(success),
            None => GREY.to_owned(),
        };
        let width = if edge.is_on_path { 4.0 } else { 2.0 };
        let style = format!("stroke=\"{colour}\" stroke-width=\"{width}\"");
        svg.line([ax + dx, ay + dy, bx + dx, by + dy], &style);
        if let Some(success) = edge.success {
            // Nearer to the start, so that the labels of the two directions do not overlap.
            let (x, y) = (
                ax + 0.4 * along - across / length * (aside + BESIDE),
                ay + 0.4 * across + along / length * (aside + BESIDE),
            );
            let style = format!("font-size=\"10\" fill=\"#404040\" {HALO} {MIDDLE}");
            svg.text([x, y + 3.0], &percent(success), &style);
        }
    }
}

/// Positions in pixels, y downwards, scaled so that the longer side takes [`SIDE`]; and pixels per unit.
fn scaled(places_m: &[[f64; 2]]) -> (Vec<[f64; 2]>, f64) {
    let bound =
        |axis: usize, pick: fn(f64, f64) -> f64, from: f64| places_m.iter().map(|place| place[axis]).fold(from, pick);
    let [low_x, low_y] = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let [high_x, high_y] = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let scale = SIDE / (high_x - low_x).max(high_y - low_y).max(1e-9);
    let scale = if scale.is_finite() { scale.min(SIDE) } else { 0.0 };
    let place = |[x, y]: &[f64; 2]| [MARGIN + (x - low_x) * scale, MARGIN + (high_y - y) * scale];
    (places_m.iter().map(place).collect(), scale)
}

/// The colour of a probability that the person is there: darker where it is greater, as in pictures of grids.
fn presence_colour(probability: f64) -> String {
    hex(mark(probability))
}

/// The colour of an edge: the less likely a traversal succeeds, the darker.
fn success_colour(success: f64) -> String {
    presence_colour(1.0 - success)
}

fn percent(probability: f64) -> String {
    format!("{:.0}", 100.0 * probability)
}
