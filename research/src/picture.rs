//! The comparison as a picture: a bar for each lead time and model, in SVG.
//!
//! A bar is the mean squared error. The dashed line is the error of the baseline at the same lead time. A whisker is
//! the interval of the difference to the baseline, added to the baseline's error: if it does not cross the line, the
//! difference is significant. Labels, bars and figures have a column each, so that no text overlaps a line.
//!
//! Invariant: the same results give the same bytes; text stays inside the picture in all common fonts.

use tidemap_formats::svg::{
    Svg,
    chart::{CHART_WIDTH as WIDTH, FONT_SIZE as NORMAL, Scale, draw_key, number, text_width},
};

use super::{Comparison, ModelResult, Protocol};

const MARGIN: f64 = 16.0;
/// The column of labels ends here, and the bars start.
const LABELS: f64 = 310.0;
/// Width of the column of figures, right of the bars.
const FIGURES: f64 = 90.0;
const TOP: f64 = 56.0;
const ROW: f64 = 36.0;
const BAR: f64 = 18.0;
const BOTTOM: f64 = 100.0;
/// Font size of parameters.
const SMALL: f64 = 11.0;

const GRID: &str = "stroke=\"#e4e4e4\"";
const WHISKER: &str = "stroke=\"#111111\" stroke-width=\"1.5\"";
const DASHED: &str = "stroke=\"#555555\" stroke-dasharray=\"4 3\"";

/// Blue and orange, as in the pictures of maps.
const BETTER: &str = "#2f7fc1";
const WORSE: &str = "#cd4600";
const UNDECIDED: &str = "#aaaaaa";
const BASELINE: &str = "#555555";

fn colour(protocol: &Protocol, model: &ModelResult) -> &'static str {
    match model.verdict(protocol.significance) {
        Some("baseline") => BASELINE,
        Some("better") => BETTER,
        Some("worse") => WORSE,
        _ => UNDECIDED,
    }
}

/// Draws the comparison.
pub(crate) fn draw(protocol: &Protocol, outcome: &Comparison) -> String {
    let models = &outcome.models;
    let of_lag = protocol.models.len().max(1);
    let baseline_mse =
        |index: usize| models.get(index / of_lag * of_lag + protocol.baseline).map_or(0.0, |model| model.score.mse());
    let whisker = |index: usize, model: &ModelResult| {
        let (lower, upper) = model.difference?.test?.interval?;
        // Identical predictions have an empty interval.
        (lower < upper).then_some((baseline_mse(index) + lower, baseline_mse(index) + upper))
    };
    let highest = |(index, model): (usize, &ModelResult)| {
        whisker(index, model).map_or(0.0, |(_, upper)| upper).max(model.score.mse())
    };
    let highest = models.iter().enumerate().map(highest).fold(0.0, f64::max);
    let scale = Scale::up_to(highest);
    let x = |mse: f64| LABELS + (mse / scale.end()).max(0.0) * (WIDTH - LABELS - FIGURES);
    let bottom = TOP + ROW * models.len() as f64;

    let mut svg = Svg::new([WIDTH, bottom + BOTTOM], NORMAL);
    svg.text([MARGIN, 26.0], &shortened(&protocol.name, WIDTH - 2.0 * MARGIN, NORMAL), "font-weight=\"bold\"");
    for mse in scale.ticks() {
        svg.line([x(mse), TOP - 4.0, x(mse), bottom + 4.0], GRID);
        svg.text([x(mse), bottom + 20.0], &number(mse), "text-anchor=\"middle\"");
    }
    svg.text([(LABELS + WIDTH - FIGURES) / 2.0, bottom + 40.0], "mean squared error", "text-anchor=\"middle\"");
    for (index, model) in models.iter().enumerate() {
        let (middle, mse) = (TOP + ROW * (index as f64 + 0.5), model.score.mse());
        svg.rectangle(
            [LABELS, middle - BAR / 2.0, x(mse) - LABELS, BAR],
            &format!("fill=\"{}\"", colour(protocol, model)),
        );
        let room = LABELS - 10.0 - MARGIN;
        let label = model.ahead.map_or_else(|| model.label.clone(), |ahead| format!("{}, {ahead}", model.label));
        let (label, parameters) = (shortened(&label, room, NORMAL), shortened(&model.parameters, room, SMALL));
        let below = if parameters.is_empty() { 4.0 } else { -3.0 };
        svg.text([LABELS - 10.0, middle + below], &label, "text-anchor=\"end\"");
        if !parameters.is_empty() {
            let style = format!("text-anchor=\"end\" font-size=\"{SMALL}\" fill=\"#666666\"");
            svg.text([LABELS - 10.0, middle + 11.0], &parameters, &style);
        }
        svg.text([WIDTH - MARGIN, middle + 4.0], &number(mse), "text-anchor=\"end\"");
        if let Some((lower, upper)) = whisker(index, model) {
            svg.line([x(lower), middle, x(upper), middle], WHISKER);
            for end in [x(lower), x(upper)] {
                svg.line([end, middle - 4.0, end, middle + 4.0], WHISKER);
            }
        }
    }
    for first in (0..models.len()).step_by(of_lag) {
        let line = x(baseline_mse(first));
        let (from, until) = (TOP + ROW * first as f64, TOP + ROW * (first + of_lag) as f64);
        svg.line([line, from - 4.0, line, until + 4.0], DASHED);
    }
    legend(&mut svg, bottom + 66.0, protocol, models.get(protocol.baseline).map_or("", |model| model.label.as_str()));
    svg.finish()
}

/// Explains colours and lines.
fn legend(svg: &mut Svg, top: f64, protocol: &Protocol, baseline: &str) {
    let baseline = shortened(baseline, 150.0, NORMAL);
    let percent = number((1.0 - protocol.significance) * 100.0);
    let rows = [
        vec![
            (format!("stroke=\"{BETTER}\" stroke-width=\"10\""), "better".to_owned()),
            (format!("stroke=\"{WORSE}\" stroke-width=\"10\""), "worse".to_owned()),
            (format!("stroke=\"{UNDECIDED}\" stroke-width=\"10\""), "undecided".to_owned()),
            (format!("stroke=\"{BASELINE}\" stroke-width=\"10\""), "baseline".to_owned()),
        ],
        vec![
            (DASHED.to_owned(), format!("error of {baseline}")),
            (WHISKER.to_owned(), format!("{percent} % interval of the difference to it")),
        ],
    ];
    for (row, keys) in rows.into_iter().enumerate() {
        let (mut left, middle) = (MARGIN, top + 20.0 * row as f64);
        for (style, meaning) in keys {
            left = draw_key(svg, [left, middle], &style, &meaning);
        }
    }
}

/// The text, or as much of its start as fits into `room` pixels.
fn shortened(text: &str, room: f64, height: f64) -> String {
    if text_width(text, height) <= room {
        return text.to_owned();
    }
    let letters = (room / text_width("m", height)) as usize;
    text.chars().take(letters.saturating_sub(1)).chain(['…']).collect()
}
