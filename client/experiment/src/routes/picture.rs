//! The failures over the weeks as a picture, a line for each robot.
//!
//! Invariant: the same results give the same bytes.

use super::RouteComparison;
use crate::picture::{Svg, WIDTH, number, tick};

const LEFT: f64 = 56.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 48.0;
const HEIGHT: f64 = 280.0;
/// Told apart by people who see few colours too (M. Okabe and K. Ito, "Color universal design", 2008).
const COLOURS: [&str; 5] = ["#000000", "#0072b2", "#56b4e9", "#d55e00", "#009e73"];

/// Draws the weeks.
pub fn draw(outcome: &RouteComparison) -> String {
    let weeks = outcome.weeks;
    let failures = |course: &super::RobotCourse, week: usize| course.failures(week..week + 1).mean;
    let all = outcome.courses.iter().flat_map(|course| (0..weeks).map(move |week| failures(course, week)));
    let tick = tick(all.clone().fold(0.0, f64::max));
    let ticks = (all.fold(0.0, f64::max) / tick).ceil().max(1.0);
    let width = WIDTH - LEFT - RIGHT;
    let x = |week: usize| LEFT + (week as f64 + 0.5) / weeks.max(1) as f64 * width;
    let y = |failures: f64| TOP + HEIGHT * (1.0 - failures / (tick * ticks));
    let mut svg = Svg::new(TOP + HEIGHT + 76.0);
    svg.text([16.0, 26.0], "failed traversals, by week", "text-anchor=\"start\" font-weight=\"bold\"");
    for at in 0..=ticks as u32 {
        let failures = f64::from(at) * tick;
        svg.line([LEFT, y(failures), LEFT + width, y(failures)], "stroke=\"#e4e4e4\"");
        svg.text([LEFT - 6.0, y(failures) + 4.0], &number(failures), "text-anchor=\"end\"");
    }
    for week in (0..weeks).step_by(weeks.div_ceil(20).max(1)) {
        svg.text([x(week), TOP + HEIGHT + 20.0], &(week + 1).to_string(), "text-anchor=\"middle\"");
    }
    for (index, course) in outcome.courses.iter().enumerate() {
        let style = format!("stroke=\"{}\" stroke-width=\"1.6\" fill=\"none\"", COLOURS[index % COLOURS.len()]);
        for week in 1..weeks {
            let at = |week: usize| y(failures(course, week));
            svg.line([x(week - 1), at(week - 1), x(week), at(week)], &style);
        }
        let left = LEFT + index as f64 * width / COLOURS.len() as f64;
        let middle = TOP + HEIGHT + 48.0;
        svg.line([left, middle, left + 30.0, middle], &style);
        svg.text([left + 38.0, middle + 4.0], course.kind.name(), "text-anchor=\"start\"");
    }
    svg.finish()
}
