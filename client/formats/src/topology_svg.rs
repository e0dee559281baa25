//! A topological map at a time, as SVG for people: who is likely where, which ways are likely open, and a route or a search.
//!
//! Nodes lie where the map says; where it does not say of all of them, they are laid out so that near ones are near. Where a
//! probability is not known, a node or an edge is grey. Invariant: the same map gives the same bytes; y points upwards as in
//! the map; a name never breaks the file.

use std::{collections::HashMap, fmt::Write as _};

use super::colour::changing;

mod layout;
#[cfg(test)]
mod tests;

pub use layout::LAID_OUT_MAX;

/// Pixels of the drawing's longer side, without its margin.
const SIDE: f64 = 900.0;
/// Pixels around the drawing.
const MARGIN: f64 = 70.0;
/// Pixels of a node's radius.
const DISC: f64 = 15.0;
/// Pixels by which the two directions of a way are apart.
const APART: f64 = 3.0;
/// What is not known.
const GREY: &str = "#9a9a9a";
/// The way of a route or a search.
const WAY: &str = "#1a4fa3";

/// A node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DrawnNode {
    /// Its name.
    pub name: String,
    /// Where it lies, metres.
    pub at_m: Option<[f64; 2]>,
    /// How likely somebody is there.
    pub probability: Option<f64>,
    /// Where it comes in the order of a search or a route, from 1.
    pub step: Option<usize>,
}

/// A way from one node to another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DrawnEdge {
    /// Node where it begins, counted from 0.
    pub from: usize,
    /// Node where it ends.
    pub to: usize,
    /// How far apart they are, in whatever unit; for the layout.
    pub length: f64,
    /// How likely it is passed.
    pub success: Option<f64>,
    /// Whether it is on the way.
    pub is_on_way: bool,
}

/// What is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopologyPicture {
    /// A line above the drawing.
    pub title: String,
    /// The nodes.
    pub nodes: Vec<DrawnNode>,
    /// The edges, each direction as one.
    pub edges: Vec<DrawnEdge>,
}

/// Why a map cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TopologyPictureError {
    /// There is nothing.
    #[error("the map has no nodes: there is nothing to draw")]
    Empty,
    /// Too many nodes would have to be laid out.
    #[error(
        "{without} of {nodes} nodes have no position, and more than {LAID_OUT_MAX} nodes are not laid out: tell where they \
         lie, with `tidemap topology edit set-node --position`"
    )]
    TooMany {
        /// Nodes without a position.
        without: usize,
        /// Nodes.
        nodes: usize,
    },
}

/// Draws a map.
///
/// # Errors
/// [`TopologyPictureError`].
pub fn write(picture: &TopologyPicture) -> Result<String, TopologyPictureError> {
    let places = fitted(&layout::places(&picture.nodes, &picture.edges)?);
    let far = |axis: usize| places.iter().map(|place| place[axis]).fold(0.0, f64::max) + MARGIN;
    let (width, height) = (far(0), far(1));
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.1} {height:.1}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
         <text x=\"12\" y=\"22\" font-size=\"15\">{}</text>\n",
        escaped(&picture.title)
    );
    draw_edges(&mut svg, &picture.edges, &places);
    for (node, [x, y]) in picture.nodes.iter().zip(&places) {
        let fill = node.probability.map_or_else(|| GREY.to_owned(), likely);
        let line = if node.step.is_some() { WAY } else { "#404040" };
        let inside = match (node.step, node.probability) {
            (Some(step), _) => step.to_string(),
            (None, Some(probability)) => percent(probability),
            (None, None) => String::new(),
        };
        let below = match (node.step, node.probability) {
            (Some(_), Some(probability)) => format!("{} {}%", escaped(&node.name), percent(probability)),
            _ => escaped(&node.name),
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{DISC}\" fill=\"{fill}\" stroke=\"{line}\" stroke-width=\"2\"/>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{inside}</text>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{below}</text>",
            y + 4.0,
            y + DISC + 14.0
        );
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Each direction beside the other; a percentage in the middle of each whose success is known.
fn draw_edges(svg: &mut String, edges: &[DrawnEdge], places: &[[f64; 2]]) {
    let mut both: HashMap<(usize, usize), u32> = HashMap::new();
    for edge in edges {
        *both.entry((edge.from.min(edge.to), edge.from.max(edge.to))).or_default() += 1;
    }
    for edge in edges {
        let (Some(&[ax, ay]), Some(&[bx, by])) = (places.get(edge.from), places.get(edge.to)) else { continue };
        let (along, across) = (bx - ax, by - ay);
        let length = along.hypot(across).max(1e-9);
        let is_single = both.get(&(edge.from.min(edge.to), edge.from.max(edge.to))) == Some(&1);
        let aside = if is_single { 0.0 } else { APART };
        let (dx, dy) = (-across / length * aside, along / length * aside);
        let colour = if edge.is_on_way { WAY.to_owned() } else { edge.success.map_or_else(|| GREY.to_owned(), open) };
        let width = if edge.is_on_way { 4.0 } else { 2.0 };
        let _ = writeln!(
            svg,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>",
            ax + dx,
            ay + dy,
            bx + dx,
            by + dy
        );
        if let Some(success) = edge.success {
            // Nearer to where it begins, so that those of both directions stand apart.
            let (x, y) = (ax + 0.4 * along + 3.0 * dx, ay + 0.4 * across + 3.0 * dy);
            let _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"10\" fill=\"#404040\" text-anchor=\"middle\">{}</text>",
                y + 3.0,
                percent(success)
            );
        }
    }
}

/// Places in pixels: y downwards, the longer side as long as there is room.
fn fitted(places_m: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let bound =
        |axis: usize, pick: fn(f64, f64) -> f64, from: f64| places_m.iter().map(|place| place[axis]).fold(from, pick);
    let [low_x, low_y] = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let [high_x, high_y] = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let scale = SIDE / (high_x - low_x).max(high_y - low_y).max(1e-9);
    let scale = if scale.is_finite() { scale.min(SIDE) } else { 0.0 };
    places_m.iter().map(|[x, y]| [MARGIN + (x - low_x) * scale, MARGIN + (high_y - y) * scale]).collect()
}

/// The colour of a probability that somebody is there: the scale of changing cells.
#[allow(clippy::cast_possible_truncation, reason = "a colour has eight bits")]
fn likely(probability: f64) -> String {
    let [r, g, b] = changing(probability as f32);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The colour of a way: the less likely it is passed, the nearer to orange.
fn open(success: f64) -> String {
    likely(1.0 - success)
}

fn percent(probability: f64) -> String {
    format!("{:.0}", 100.0 * probability)
}

/// Text between tags.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
