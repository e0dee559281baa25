//! The error over time as a picture, a line for each explorer, as figure 6 of RA-L 2016.
//!
//! Invariant: the same results give the same bytes. What is off the scale of the days after the first is cut off.

use super::{OfficeExploration, OfficeProtocol};
use crate::picture::{Svg, WIDTH, number, tick};

const LEFT: f64 = 56.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 64.0;
const HEIGHT: f64 = 280.0;
const COLOURS: [&str; 3] = ["#000000", "#0072b2", "#d55e00"];

/// Draws the errors.
pub fn draw(protocol: &OfficeProtocol, outcome: &OfficeExploration) -> String {
    let per_day = protocol.slots();
    let slots = protocol.days * per_day;
    let percent = |index: usize, slot: usize| outcome.error_at(index, slot).map(|error| 100.0 * error);
    // While nothing is learned, all that stands is expected to be free: that would hide everything after it.
    let first = if protocol.days > 1 { per_day } else { 0 };
    let most = (0..protocol.explorers.len())
        .flat_map(|index| (first..slots).filter_map(move |slot| percent(index, slot)))
        .fold(0.0, f64::max);
    let tick = tick(most);
    let ticks = (most / tick).ceil().max(1.0);
    let width = WIDTH - LEFT - RIGHT;
    let x = |slot: f64| LEFT + slot / slots.max(1) as f64 * width;
    let y = |percent: f64| TOP + HEIGHT * (1.0 - (percent / (tick * ticks)).min(1.0));
    let mut svg = Svg::new(TOP + HEIGHT + 76.0);
    svg.text([16.0, 26.0], &protocol.name, "text-anchor=\"start\" font-weight=\"bold\"");
    svg.text([16.0, 46.0], "cells expected wrongly, percent of those seen so far, by day", "text-anchor=\"start\"");
    for at in 0..=ticks as u32 {
        let percent = f64::from(at) * tick;
        svg.line([LEFT, y(percent), LEFT + width, y(percent)], "stroke=\"#e4e4e4\"");
        svg.text([LEFT - 6.0, y(percent) + 4.0], &number(percent), "text-anchor=\"end\"");
    }
    for day in 0..protocol.days {
        let at = x((day * per_day) as f64);
        svg.line([at, TOP, at, TOP + HEIGHT], "stroke=\"#c0c0c0\"");
        let middle = x((day * per_day) as f64 + per_day as f64 / 2.0);
        svg.text([middle, TOP + HEIGHT + 20.0], &(day + 1).to_string(), "text-anchor=\"middle\"");
    }
    for (index, kind) in protocol.explorers.iter().enumerate() {
        let style = format!("stroke=\"{}\" stroke-width=\"1.4\" fill=\"none\"", COLOURS[index % COLOURS.len()]);
        for slot in 1..slots {
            if let (Some(before), Some(now)) = (percent(index, slot - 1), percent(index, slot)) {
                svg.line([x(slot as f64 - 0.5), y(before), x(slot as f64 + 0.5), y(now)], &style);
            }
        }
        let left = LEFT + index as f64 * width / 3.0;
        let middle = TOP + HEIGHT + 48.0;
        svg.line([left, middle, left + 30.0, middle], &style);
        svg.text([left + 38.0, middle + 4.0], kind.name(), "text-anchor=\"start\"");
    }
    svg.finish()
}
