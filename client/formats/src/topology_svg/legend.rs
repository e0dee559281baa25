//! The legend of a drawing: the meanings of its colours and numbers, and its scale.
//!
//! Invariant: the legend stands below the drawing and explains only what is drawn.

use tidemap_picture::scale_bar;

use super::{GREY, PATH, presence_colour, success_colour};
use crate::svg::Svg;

/// Height of the legend, pixels.
pub(super) const HEIGHT: f64 = 96.0;
/// Width that its texts need, pixels.
pub(super) const WIDTH: f64 = 600.0;
const LEFT: f64 = 12.0;
const LINE: f64 = 18.0;
/// The x coordinate at which the texts begin, behind the colours.
const TEXT: f64 = 128.0;
/// Maximum length of the scale bar, pixels.
const BAR_MAX: f64 = 200.0;

/// Draws the legend with its upper edge at `top`. `pixels_per_m`: of a drawing with positions in metres.
pub(super) fn draw(svg: &mut Svg, top: f64, has_path: bool, pixels_per_m: Option<f64>) {
    let mut y = top;
    let mut row = |svg: &mut Svg, colour: Option<fn(f64) -> String>, text: &str| {
        for (step, x) in (0..=5_u32).map(|step| (f64::from(step) / 5.0, LEFT + 18.0 * f64::from(step))) {
            if let Some(colour) = colour {
                svg.rectangle([x, y - 10.0, 18.0, 12.0], &format!("fill=\"{}\"", colour(step)));
            }
        }
        svg.text([TEXT, y], text, "");
        y += LINE;
    };
    row(svg, Some(presence_colour), "node, number in %: probability that the person or object is there, 0 to 100");
    row(svg, Some(success_colour), "edge, number in %: probability that the robot passes it, 0 to 100");
    row(svg, Some(|_| GREY.to_owned()), "grey: not observed yet");
    if has_path {
        row(svg, Some(|_| PATH.to_owned()), "blue: the planned way; a number in a node counts its places");
    }
    if let Some((length, text)) = pixels_per_m.and_then(|pixels| scale_bar(pixels, BAR_MAX)) {
        svg.polyline([[LEFT, y - 8.0], [LEFT, y - 3.0], [LEFT + length, y - 3.0], [LEFT + length, y - 8.0]], BAR);
        svg.text([LEFT + length + 8.0, y], &text, "");
    }
}

const BAR: &str = "stroke=\"#111111\" stroke-width=\"1.5\"";
