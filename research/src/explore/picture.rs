//! The error over the weeks as a picture: a panel for each share of slots and strategy, with a line for each model.
//!
//! Invariant: the same results give the same bytes; all panels have the same scale.

use tidemap_formats::svg::{
    Svg,
    chart::{CHART_WIDTH, FONT_SIZE, HEADING, Panel, Scale, draw_key, series_style},
};

use super::{Exploration, PlacesProtocol, StrategyResult, VisitStrategy, WEEK_DAYS};

const COLUMNS: usize = 2;
const LEFT: f64 = 48.0;
const GAP: f64 = 44.0;
const TOP: f64 = 76.0;
const HEIGHT: f64 = 180.0;
const LEGEND_ROW: f64 = 20.0;

/// Draws the weeks.
pub(super) fn draw(protocol: &PlacesProtocol, outcome: &Exploration) -> String {
    let weeks = outcome.days.div_ceil(WEEK_DAYS).max(1);
    let percent = |result: &StrategyResult, week: usize| {
        100.0 * result.error(week * WEEK_DAYS..outcome.days.min((week + 1) * WEEK_DAYS)).mean
    };
    let all = outcome.results.iter().flat_map(|result| (0..weeks).map(move |week| percent(result, week)));
    let scale = Scale::up_to(all.fold(0.0, f64::max));
    let width = (CHART_WIDTH - LEFT - GAP * COLUMNS as f64) / COLUMNS as f64;
    let several = protocol.explorations.len() > 1;
    let worths =
        |share: f64, strategy: VisitStrategy| protocol.worths.iter().map(move |&worth| (share, strategy, worth));
    let strategies = |&share: &f64| {
        protocol.strategies.iter().flat_map(move |&strategy| worths(share, strategy)).collect::<Vec<_>>()
    };
    let panels: Vec<_> = protocol.explorations.iter().flat_map(strategies).collect();
    let left = |index: usize| LEFT + (index % COLUMNS) as f64 * (width + GAP);
    let legend_top = TOP + panels.len().div_ceil(COLUMNS) as f64 * (HEIGHT + GAP + 16.0);
    let legend_height = LEGEND_ROW * protocol.models.len().div_ceil(COLUMNS) as f64;
    let mut svg = Svg::new([CHART_WIDTH, legend_top + legend_height + 24.0], FONT_SIZE);
    svg.text([16.0, 26.0], &protocol.name, HEADING);
    svg.text([16.0, 46.0], "wrong states, percent of all, by week", "text-anchor=\"start\"");
    for (index, &(share, strategy, worth)) in panels.iter().enumerate() {
        let top = TOP + (index / COLUMNS) as f64 * (HEIGHT + GAP + 16.0);
        let panel = Panel { area: [left(index), top, width, HEIGHT], steps: weeks, scale };
        let mut heading = strategy.name().to_owned();
        if protocol.worths.len() > 1 {
            heading += &format!(", {}", worth.name());
        }
        if several {
            heading += &format!(", {share}");
        }
        svg.text([left(index), top - 8.0], &heading, HEADING);
        panel.draw_grid(&mut svg);
        for week in (0..weeks).step_by(weeks.div_ceil(12)) {
            panel.label(&mut svg, week as f64 + 0.5, &(week + 1).to_string());
        }
        for (index, model) in protocol.models.iter().enumerate() {
            let is_this = |result: &&StrategyResult| {
                let is_of_panel = result.exploration == share && result.strategy == strategy && result.worth == worth;
                is_of_panel && result.model == *model
            };
            for result in outcome.results.iter().filter(is_this) {
                panel.draw_series(&mut svg, (0..weeks).map(|week| Some(percent(result, week))), &series_style(index));
            }
        }
    }
    for (index, model) in protocol.models.iter().enumerate() {
        let middle = legend_top + LEGEND_ROW * (index / COLUMNS) as f64;
        draw_key(&mut svg, [left(index), middle], &series_style(index), &model.name());
    }
    svg.finish()
}
