//! The comparison as a picture: a bar per model, as SVG, which needs no font of ours and can be read in a diff.
//!
//! A bar is the mean squared error. The dashed line is the baseline's; a whisker is the interval of the difference to the
//! baseline, laid from that line: where it does not cross the line, the difference is significant. Labels, bars and figures
//! have a column each, so that no text meets a line.
//! Invariant: the same results give the same bytes; text is escaped, and stays in the picture in any usual font.

use std::fmt::Write as _;

use super::{Comparison, ModelResult, Protocol};

pub(super) const WIDTH: f64 = 860.0;
const MARGIN: f64 = 16.0;
/// The column of labels ends here, and bars begin.
const LABELS: f64 = 310.0;
/// Room for the figures right of the bars.
const FIGURES: f64 = 90.0;
const TOP: f64 = 56.0;
const ROW: f64 = 36.0;
const BAR: f64 = 18.0;
const BOTTOM: f64 = 100.0;
/// Heights of letters.
const NORMAL: f64 = 13.0;
const SMALL: f64 = 11.0;
/// No usual font has letters that are wider on average, as a share of their height.
const LETTER_WIDTH: f64 = 0.63;

const GRID: &str = "stroke=\"#e4e4e4\"";
const WHISKER: &str = "stroke=\"#111111\" stroke-width=\"1.5\"";
const DASHED: &str = "stroke=\"#555555\" stroke-dasharray=\"4 3\"";

/// Blue and orange as in the pictures of maps.
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
pub fn draw(protocol: &Protocol, outcome: &Comparison) -> String {
    let models = &outcome.models;
    let baseline_mse = models.get(protocol.baseline).map_or(0.0, |model| model.score.mse());
    let whisker = |model: &ModelResult| {
        let (lower, upper) = model.difference?.test?.interval?;
        // The same predictions differ by nothing.
        (lower < upper).then_some((baseline_mse + lower, baseline_mse + upper))
    };
    let highest = |model: &ModelResult| whisker(model).map_or(0.0, |(_, upper)| upper).max(model.score.mse());
    let most = models.iter().map(highest).fold(0.0, f64::max);
    let tick = tick(most);
    let ticks = (most / tick).ceil().max(1.0);
    let x = |mse: f64| LABELS + (mse / (tick * ticks)).max(0.0) * (WIDTH - LABELS - FIGURES);
    let bottom = TOP + ROW * models.len() as f64;

    let mut svg = Svg::new(bottom + BOTTOM);
    svg.text([MARGIN, 26.0], &shortened(&protocol.name, WIDTH - 2.0 * MARGIN, NORMAL), "font-weight=\"bold\"");
    for at in 0..=ticks as u32 {
        let mse = f64::from(at) * tick;
        svg.line([x(mse), TOP - 4.0, x(mse), bottom + 4.0], GRID);
        svg.text([x(mse), bottom + 20.0], &number(mse), "text-anchor=\"middle\"");
    }
    svg.text([(LABELS + WIDTH - FIGURES) / 2.0, bottom + 40.0], "mean squared error", "text-anchor=\"middle\"");
    for (index, model) in models.iter().enumerate() {
        let (middle, mse) = (TOP + ROW * (index as f64 + 0.5), model.score.mse());
        svg.rectangle([LABELS, middle - BAR / 2.0, x(mse) - LABELS, BAR], colour(protocol, model));
        let room = LABELS - 10.0 - MARGIN;
        let (label, parameters) = (shortened(&model.label, room, NORMAL), shortened(&model.parameters, room, SMALL));
        let below = if parameters.is_empty() { 4.0 } else { -3.0 };
        svg.text([LABELS - 10.0, middle + below], &label, "text-anchor=\"end\"");
        if !parameters.is_empty() {
            let style = format!("text-anchor=\"end\" font-size=\"{SMALL}\" fill=\"#666666\"");
            svg.text([LABELS - 10.0, middle + 11.0], &parameters, &style);
        }
        svg.text([WIDTH - MARGIN, middle + 4.0], &number(mse), "text-anchor=\"end\"");
        if let Some((lower, upper)) = whisker(model) {
            svg.line([x(lower), middle, x(upper), middle], WHISKER);
            for end in [x(lower), x(upper)] {
                svg.line([end, middle - 4.0, end, middle + 4.0], WHISKER);
            }
        }
    }
    let line = x(baseline_mse);
    svg.line([line, TOP - 4.0, line, bottom + 4.0], DASHED);
    legend(&mut svg, bottom + 66.0, protocol, models.get(protocol.baseline).map_or("", |model| model.label.as_str()));
    svg.finish()
}

/// What colours and lines mean.
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
            svg.line([left, middle, left + 22.0, middle], &style);
            svg.text([left + 30.0, middle + 4.0], &meaning, "text-anchor=\"start\"");
            left += 54.0 + width(&meaning, NORMAL);
        }
    }
}

/// A distance of ticks of which five or so make `most`: 1, 2 or 5 times a power of ten.
pub(super) fn tick(most: f64) -> f64 {
    if !(most.is_finite() && most > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powf((most / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * power >= most / 5.0);
    steps.unwrap_or(10.0) * power
}

/// Four significant digits.
pub(super) fn number(number: f64) -> String {
    let rounded: f64 = format!("{number:.3e}").parse().unwrap_or(number);
    let is_short = rounded == 0.0 || (1e-4..1e7).contains(&rounded.abs());
    if is_short { rounded.to_string() } else { format!("{rounded:e}") }
}

/// How wide a text is at the most, about.
fn width(text: &str, height: f64) -> f64 {
    LETTER_WIDTH * height * text.chars().count() as f64
}

/// What fits into a room.
fn shortened(text: &str, room: f64, height: f64) -> String {
    if width(text, height) <= room {
        return text.to_owned();
    }
    let fit = (room / (LETTER_WIDTH * height)) as usize;
    text.chars().take(fit.saturating_sub(1)).chain(['…']).collect()
}

pub(super) struct Svg(String);

impl Svg {
    pub(super) fn new(height: f64) -> Self {
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
             viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"{NORMAL}\" fill=\"#111111\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
        ))
    }

    pub(super) fn line(&mut self, [x1, y1, x2, y2]: [f64; 4], style: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" {style}/>");
    }

    fn rectangle(&mut self, [x, y, width, height]: [f64; 4], fill: &str) {
        let _ = writeln!(
            self.0,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"/>"
        );
    }

    pub(super) fn text(&mut self, [x, y]: [f64; 2], text: &str, style: &str) {
        let escaped: String = text.chars().map(escaped).collect();
        let _ = writeln!(self.0, "<text x=\"{x:.1}\" y=\"{y:.1}\" {style}>{escaped}</text>");
    }

    pub(super) fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }
}

/// A character as XML has it; one that XML cannot have is shown as a replacement.
fn escaped(character: char) -> String {
    match character {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        _ if character.is_control() => '\u{fffd}'.to_string(),
        _ => character.to_string(),
    }
}
