//! The comparison as a picture: a bar per model, as SVG, which needs no font of ours and can be read in a diff.
//!
//! A bar is the mean squared error. The dashed line is the baseline's; a whisker is the interval of the difference to the
//! baseline, laid from that line: where it does not cross the line, the difference is significant.
//! Invariant: the same results give the same bytes; text is escaped.

use std::fmt::Write as _;

use super::{Compared, Outcome, Protocol};

pub(super) const WIDTH: f64 = 860.0;
const LABELS: f64 = 300.0;
/// Room for the figure right of a bar.
const FIGURES: f64 = 90.0;
const TOP: f64 = 56.0;
const ROW: f64 = 30.0;
const BOTTOM: f64 = 64.0;

/// Blue where better, orange where worse, as in the pictures of maps; light grey where undecided.
fn colour(protocol: &Protocol, model: &Compared) -> &'static str {
    match model.verdict(protocol.significance) {
        Some("baseline") => "#555555",
        Some("better") => "#2f7fc1",
        Some("worse") => "#cd4600",
        _ => "#aaaaaa",
    }
}

/// Draws the comparison.
pub fn draw(protocol: &Protocol, outcome: &Outcome) -> String {
    let models = &outcome.models;
    let baseline_mse = models.get(protocol.baseline).map_or(0.0, |model| model.score.mse());
    let whisker = |model: &Compared| {
        let (lower, upper) = model.difference?.test?.interval?;
        Some((baseline_mse + lower, baseline_mse + upper))
    };
    let highest = |model: &Compared| whisker(model).map_or(0.0, |(_, upper)| upper).max(model.score.mse());
    let most = models.iter().map(highest).fold(0.0, f64::max);
    let tick = tick(most);
    let ticks = (most / tick).ceil().max(1.0);
    let x = |mse: f64| LABELS + (mse / (tick * ticks)).max(0.0) * (WIDTH - LABELS - FIGURES);
    let bottom = TOP + ROW * models.len() as f64;

    let mut svg = Svg::new(bottom + BOTTOM);
    svg.text(16.0, 26.0, "start", "bold", &protocol.name);
    for at in 0..=ticks as u32 {
        let mse = f64::from(at) * tick;
        svg.line([x(mse), TOP - 4.0, x(mse), bottom + 4.0], "stroke=\"#e4e4e4\"");
        svg.text(x(mse), bottom + 20.0, "middle", "normal", &number(mse));
    }
    for (index, model) in models.iter().enumerate() {
        let (top, mse) = (TOP + ROW * index as f64, model.score.mse());
        let middle = top + ROW / 2.0;
        svg.rectangle([LABELS, top + 6.0, x(mse) - LABELS, ROW - 12.0], colour(protocol, model));
        let label = format!("{} {}", model.label, model.parameters);
        svg.text(LABELS - 10.0, middle + 4.0, "end", "normal", shortened(label.trim_end()).as_str());
        let ends = whisker(model).map_or(mse, |(_, upper)| upper.max(mse));
        svg.text(x(ends) + 8.0, middle + 4.0, "start", "normal", &number(mse));
        if let Some((lower, upper)) = whisker(model) {
            let style = "stroke=\"#111111\" stroke-width=\"1.5\"";
            svg.line([x(lower), middle, x(upper), middle], style);
            svg.line([x(lower), middle - 4.0, x(lower), middle + 4.0], style);
            svg.line([x(upper), middle - 4.0, x(upper), middle + 4.0], style);
        }
    }
    let line = x(baseline_mse);
    svg.line([line, TOP - 4.0, line, bottom + 4.0], "stroke=\"#555555\" stroke-dasharray=\"4 3\"");
    let baseline = models.get(protocol.baseline).map_or("", |model| model.label.as_str());
    let percent = number((1.0 - protocol.significance) * 100.0);
    let legend = format!(
        "mean squared error; dashed: {baseline}; whiskers: {percent} % interval of the difference to it; blue: better, \
         orange: worse"
    );
    svg.text(16.0, bottom + 46.0, "start", "normal", &legend);
    svg.finish()
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
    rounded.to_string()
}

/// What fits beside the bars.
fn shortened(label: &str) -> String {
    const CHARS_MAX: usize = 44;
    let mut shown: String = label.chars().take(CHARS_MAX).collect();
    if label.chars().nth(CHARS_MAX).is_some() {
        shown.push('…');
    }
    shown
}

pub(super) struct Svg(String);

impl Svg {
    pub(super) fn new(height: f64) -> Self {
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
             viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" font-size=\"13\" fill=\"#111111\">\n\
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

    pub(super) fn text(&mut self, x: f64, y: f64, anchor: &str, weight: &str, text: &str) {
        let escaped: String = text.chars().map(escaped).collect();
        let _ = writeln!(
            self.0,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-weight=\"{weight}\">{escaped}</text>"
        );
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
