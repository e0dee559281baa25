//! The error over the weeks as a picture: a panel for each strategy, in it a line for each model.
//!
//! Invariant: the same results give the same bytes; all panels have one scale.

use super::{Exploration, PlacesProtocol, WEEK_DAYS};
use crate::picture::{Svg, WIDTH, number, tick};

const COLUMNS: usize = 2;
const LEFT: f64 = 48.0;
const GAP: f64 = 44.0;
const TOP: f64 = 76.0;
const HEIGHT: f64 = 180.0;
const LEGEND_ROW: f64 = 20.0;

/// Told apart by people who see few colours too (M. Okabe and K. Ito, "Color universal design", 2008), then dashed.
const COLOURS: [&str; 7] = ["#000000", "#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7"];

fn style(model: usize) -> String {
    let dashes = ["", " stroke-dasharray=\"6 3\"", " stroke-dasharray=\"2 2\""];
    let (colour, dash) = (COLOURS[model % COLOURS.len()], dashes[model / COLOURS.len() % dashes.len()]);
    format!("stroke=\"{colour}\" stroke-width=\"1.6\" fill=\"none\"{dash}")
}

/// Draws the weeks.
pub fn draw(protocol: &PlacesProtocol, outcome: &Exploration) -> String {
    let weeks = outcome.days.div_ceil(WEEK_DAYS).max(1);
    let percent = |pair: &super::StrategyResult, week: usize| {
        100.0 * pair.error(week * WEEK_DAYS..outcome.days.min((week + 1) * WEEK_DAYS)).mean
    };
    let most = outcome.pairs.iter().flat_map(|pair| (0..weeks).map(|week| percent(pair, week))).fold(0.0, f64::max);
    let tick = tick(most);
    let ticks = (most / tick).ceil().max(1.0);
    let width = (WIDTH - LEFT - GAP * COLUMNS as f64) / COLUMNS as f64;
    let rows = protocol.plans.len().div_ceil(COLUMNS);
    let legend_top = TOP + rows as f64 * (HEIGHT + GAP + 16.0);
    let mut svg = Svg::new(legend_top + LEGEND_ROW * protocol.models.len().div_ceil(COLUMNS) as f64 + 24.0);
    svg.text([16.0, 26.0], &protocol.name, "text-anchor=\"start\" font-weight=\"bold\"");
    svg.text([16.0, 46.0], "wrong states, percent of all, by week", "text-anchor=\"start\"");
    for (index, plan) in protocol.plans.iter().enumerate() {
        let left = LEFT + (index % COLUMNS) as f64 * (width + GAP);
        let top = TOP + (index / COLUMNS) as f64 * (HEIGHT + GAP + 16.0);
        let x = |week: usize| left + (week as f64 + 0.5) / weeks as f64 * width;
        let y = |percent: f64| top + HEIGHT * (1.0 - percent / (tick * ticks));
        svg.text([left, top - 8.0], plan.name(), "text-anchor=\"start\" font-weight=\"bold\"");
        for at in 0..=ticks as u32 {
            let percent = f64::from(at) * tick;
            svg.line([left, y(percent), left + width, y(percent)], "stroke=\"#e4e4e4\"");
            svg.text([left - 6.0, y(percent) + 4.0], &number(percent), "text-anchor=\"end\"");
        }
        let step = weeks.div_ceil(12);
        for week in (0..weeks).step_by(step) {
            svg.text([x(week), top + HEIGHT + 18.0], &(week + 1).to_string(), "text-anchor=\"middle\"");
        }
        for (model, kind) in protocol.models.iter().enumerate() {
            let pair = outcome.pairs.iter().find(|pair| pair.plan == *plan && pair.model == *kind);
            for week in pair.iter().flat_map(|_| 1..weeks) {
                let at = |week: usize| pair.map_or(0.0, |pair| y(percent(pair, week)));
                svg.line([x(week - 1), at(week - 1), x(week), at(week)], &style(model));
            }
        }
    }
    for (model, kind) in protocol.models.iter().enumerate() {
        let left = LEFT + (model % COLUMNS) as f64 * (width + GAP);
        let middle = legend_top + LEGEND_ROW * (model / COLUMNS) as f64;
        svg.line([left, middle, left + 30.0, middle], &style(model));
        svg.text([left + 38.0, middle + 4.0], &kind.name(), "text-anchor=\"start\"");
    }
    svg.finish()
}
