//! The error over time as a picture, a line for each explorer, as figure 6 of RA-L 2016.
//!
//! Invariant: the same results give the same bytes. The scale is made for the days after the first; higher errors of
//! the first day are clipped.

use tidemap_formats::svg::{
    Svg,
    chart::{CHART_WIDTH, FONT_SIZE, HEADING, Panel, Scale, draw_key, series_style},
};

use super::{OfficeExploration, OfficeProtocol};

const LEFT: f64 = 56.0;
const TOP: f64 = 64.0;
const WIDTH: f64 = CHART_WIDTH - LEFT - 16.0;
const HEIGHT: f64 = 280.0;

/// Draws the errors.
pub(super) fn draw(protocol: &OfficeProtocol, outcome: &OfficeExploration) -> String {
    let per_day = protocol.slots();
    let slots = protocol.days * per_day;
    let percent = |index: usize, slot: usize| outcome.error_at(index, slot).map(|error| 100.0 * error);
    // An untrained map predicts every cell free; the scale of that error would hide everything after it.
    let first = if protocol.days > 1 { per_day } else { 0 };
    let max = (0..protocol.explorers.len())
        .flat_map(|index| (first..slots).filter_map(move |slot| percent(index, slot)))
        .fold(0.0, f64::max);
    let panel = Panel { area: [LEFT, TOP, WIDTH, HEIGHT], steps: slots, scale: Scale::up_to(max) };
    let mut svg = Svg::new([CHART_WIDTH, TOP + HEIGHT + 76.0], FONT_SIZE);
    svg.text([16.0, 26.0], &protocol.name, HEADING);
    svg.text([16.0, 46.0], "wrongly predicted cells, percent of those seen so far, by day", "text-anchor=\"start\"");
    panel.draw_grid(&mut svg);
    for day in 0..protocol.days {
        let midnight = panel.x((day * per_day) as f64);
        svg.line([midnight, TOP, midnight, panel.bottom()], "stroke=\"#c0c0c0\"");
        panel.label(&mut svg, (day as f64 + 0.5) * per_day as f64, &(day + 1).to_string());
    }
    let mut left = LEFT;
    for (index, kind) in protocol.explorers.iter().enumerate() {
        panel.draw_series(&mut svg, (0..slots).map(|slot| percent(index, slot)), &series_style(index));
        left = draw_key(&mut svg, [left, panel.bottom() + 48.0], &series_style(index), kind.name());
    }
    svg.finish()
}
