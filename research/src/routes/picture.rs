//! The failures over the weeks as a picture, a line for each robot.
//!
//! Invariant: the same results give the same bytes.

use tidemap_formats::svg::{
    Svg,
    chart::{CHART_WIDTH, FONT_SIZE, HEADING, Panel, Scale, draw_key, series_style},
};

use super::{RobotCourse, RouteComparison};

const LEFT: f64 = 56.0;
const TOP: f64 = 48.0;
const WIDTH: f64 = CHART_WIDTH - LEFT - 16.0;
const HEIGHT: f64 = 280.0;

/// Draws the weeks.
pub(super) fn draw(outcome: &RouteComparison) -> String {
    let weeks = outcome.weeks;
    let failures = |course: &RobotCourse, week: usize| course.failures(week..week + 1).mean;
    let all = outcome.courses.iter().flat_map(|course| (0..weeks).map(move |week| failures(course, week)));
    let panel = Panel { area: [LEFT, TOP, WIDTH, HEIGHT], steps: weeks, scale: Scale::up_to(all.fold(0.0, f64::max)) };
    let mut svg = Svg::new([CHART_WIDTH, TOP + HEIGHT + 76.0], FONT_SIZE);
    svg.text([16.0, 26.0], "failed traversals, by week", HEADING);
    panel.draw_grid(&mut svg);
    for week in (0..weeks).step_by(weeks.div_ceil(20).max(1)) {
        panel.label(&mut svg, week as f64 + 0.5, &(week + 1).to_string());
    }
    let mut left = LEFT;
    for (index, course) in outcome.courses.iter().enumerate() {
        panel.draw_series(&mut svg, (0..weeks).map(|week| Some(failures(course, week))), &series_style(index));
        left = draw_key(&mut svg, [left, panel.bottom() + 48.0], &series_style(index), course.kind.name());
    }
    svg.finish()
}
