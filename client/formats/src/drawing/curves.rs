//! Curves over time, one panel each, with a band around each value.
//!
//! Invariant: all panels have the same times. Values from 0 to 1 are drawn on a scale from 0 to 1.

use std::fmt::Write as _;

use tidemap_picture::short;

use super::{BARS, COLUMNS, label_line};
use crate::svg::{
    Svg,
    chart::{CHART_WIDTH, FONT_SIZE, HEADING, Scale, text_width},
};

/// Rows of a panel as text if it is alone, and if there are several.
const ROWS_ALONE: usize = 8;
const ROWS: usize = 4;
/// Height of a panel as SVG.
const PANEL_HEIGHT: f64 = 130.0;

/// Values over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// The quantity that the curve shows.
    pub name: String,
    /// A value for each time; none: a gap.
    pub values: Vec<Option<f64>>,
    /// Lower and upper end of the band around each value; may be empty.
    pub band: Vec<Option<[f64; 2]>>,
    /// Times that are marked below the curve; may be empty.
    pub marks: Vec<bool>,
}

/// Curves over the same times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurvePlot {
    /// The heading.
    pub title: String,
    /// A label for each time.
    pub labels: Vec<String>,
    /// The curves.
    pub curves: Vec<Curve>,
}

impl Curve {
    /// The ends of its scale.
    fn range(&self) -> [f64; 2] {
        let bands = self.band.iter().flatten().flatten().copied();
        let all = || self.values.iter().flatten().copied().chain(bands.clone()).filter(|value| value.is_finite());
        let (low, high) = (all().fold(0.0, f64::min), all().fold(0.0, f64::max));
        if low >= 0.0 && high <= 1.0 && !all().any(|value| value > 1.0) && high > 0.2 {
            return [0.0, 1.0];
        }
        let [low, high] = [-low, high].map(|end| if end > 0.0 { Scale::up_to(end).end() } else { 0.0 });
        if high + low > 0.0 { [0.0 - low, high] } else { [0.0, 1.0] }
    }

    /// The mean of the values of a column, and the upper end of its band.
    fn column(&self, samples: std::ops::Range<usize>) -> (Option<f64>, Option<f64>) {
        let mean = |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let values = self.values.get(samples.clone()).unwrap_or_default().iter().flatten().copied().collect();
        let upper = self.band.get(samples).unwrap_or_default().iter().flatten().map(|[_, upper]| *upper).collect();
        (mean(values), mean(upper))
    }
}

impl CurvePlot {
    /// The samples of each column of text.
    fn columns(&self) -> Vec<std::ops::Range<usize>> {
        let samples = self.labels.len();
        if samples == 0 {
            return Vec::new();
        }
        let columns = if samples <= COLUMNS { COLUMNS / samples * samples } else { COLUMNS };
        let edge = |column: usize| column * samples / columns;
        (0..columns).map(|column| edge(column)..edge(column + 1).max(edge(column) + 1)).collect()
    }

    /// The drawing as text: bars up to the values, and light shade up to the end of the band.
    #[must_use]
    pub fn text(&self) -> String {
        let columns = self.columns();
        let rows = if self.curves.len() == 1 { ROWS_ALONE } else { ROWS };
        let mut text = format!("{}\n", self.title);
        let margin = self.curves.iter().flat_map(Curve::range).map(|end| short(end).chars().count()).max().unwrap_or(0);
        for curve in &self.curves {
            let [low, high] = curve.range();
            let _ = writeln!(text, "{}", curve.name);
            let eighths = |value: f64| ((value - low) / (high - low) * (8 * rows) as f64).clamp(0.0, (8 * rows) as f64);
            for row in (0..rows).rev() {
                let scale = if row + 1 == rows {
                    short(high)
                } else if row == 0 {
                    short(low)
                } else {
                    String::new()
                };
                let line: String = columns
                    .iter()
                    .map(|samples| match curve.column(samples.clone()) {
                        (None, _) => ' ',
                        (Some(value), upper) => {
                            let piece = (eighths(value).round() as usize).saturating_sub(8 * row).min(8);
                            let is_in_band = upper.is_some_and(|upper| eighths(upper) >= (8 * row) as f64 + 4.0);
                            match piece {
                                0 if is_in_band => '░',
                                0 if row == 0 => BARS[1],
                                piece => BARS[piece],
                            }
                        }
                    })
                    .collect();
                let _ = writeln!(text, "{}", format!("  {scale:>margin$} │{line}").trim_end());
            }
            if curve.marks.iter().any(|&mark| mark) {
                let is_marked = |samples: &std::ops::Range<usize>| {
                    curve.marks.get(samples.clone()).unwrap_or_default().iter().any(|&mark| mark)
                };
                let line: String = columns.iter().map(|samples| if is_marked(samples) { '▲' } else { ' ' }).collect();
                let _ = writeln!(text, "  {:>margin$}  {}", "", line.trim_end());
            }
        }
        let labels = columns.iter().enumerate().filter(|(column, samples)| {
            *column == 0 || columns.get(column - 1).is_some_and(|before| before.start != samples.start)
        });
        let labels = labels.filter_map(|(column, samples)| Some((column, self.labels.get(samples.start)?.clone())));
        let _ = writeln!(text, "  {:>margin$}  {}", "", label_line(labels));
        text
    }

    /// The drawing as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let panels = self.curves.len() as f64;
        let height = 70.0 + panels * (PANEL_HEIGHT + 40.0);
        let mut svg = Svg::new([CHART_WIDTH, height], FONT_SIZE);
        let (left, width) = (60.0, CHART_WIDTH - 80.0);
        svg.text([left, 26.0], &self.title, HEADING);
        let samples = self.labels.len().max(1);
        let x = |sample: f64| left + (sample + 0.5) / samples as f64 * width;
        let mut top = 60.0;
        for curve in &self.curves {
            let [low, high] = curve.range();
            let y = |value: f64| top + PANEL_HEIGHT * (1.0 - ((value - low) / (high - low)).clamp(0.0, 1.0));
            svg.text([left, top - 8.0], &curve.name, "");
            for value in [low, f64::midpoint(low, high), high] {
                svg.line([left, y(value), left + width, y(value)], "stroke=\"#e4e4e4\"");
                svg.text([left - 6.0, y(value) + 4.0], &short(value), "text-anchor=\"end\"");
            }
            let band: Vec<(f64, [f64; 2])> =
                (0_u32..).zip(&curve.band).filter_map(|(at, ends)| Some((x(f64::from(at)), (*ends)?))).collect();
            let outline = band.iter().map(|(x, [_, upper])| [*x, y(*upper)]);
            let outline = outline.chain(band.iter().rev().map(|(x, [lower, _])| [*x, y(*lower)]));
            if band.len() > 1 {
                svg.polygon(outline, "fill=\"#0072b2\" fill-opacity=\"0.18\"");
            }
            let points: Vec<Option<[f64; 2]>> =
                (0_u32..).zip(&curve.values).map(|(at, value)| Some([x(f64::from(at)), y((*value)?)])).collect();
            for run in points.split(Option::is_none) {
                svg.polyline(run.iter().copied().flatten(), "stroke=\"#0072b2\" stroke-width=\"1.8\"");
            }
            for (at, _) in (0_u32..).zip(&curve.marks).filter(|(_, mark)| **mark) {
                svg.circle([x(f64::from(at)), top + PANEL_HEIGHT], 4.0, "fill=\"#d55e00\"");
            }
            top += PANEL_HEIGHT + 40.0;
        }
        let mut free = f64::MIN;
        for (at, label) in (0_u32..).zip(&self.labels) {
            if x(f64::from(at)) > free {
                svg.text([x(f64::from(at)), top - 20.0], label, "text-anchor=\"middle\"");
                free = x(f64::from(at)) + text_width(label, FONT_SIZE) + 12.0;
            }
        }
        svg.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn door() -> CurvePlot {
        let values = (0..24).map(|hour| Some(if (9..17).contains(&hour) { 0.9 } else { 0.0 }));
        CurvePlot {
            title: "door".to_owned(),
            labels: (0..24).map(|hour| format!("{hour:02}:00")).collect(),
            curves: vec![Curve {
                name: "probability <1>".to_owned(),
                values: values.collect(),
                band: (0..24).map(|hour| (hour == 3).then_some([0.0, 0.5])).collect(),
                marks: (0..24).map(|hour| hour == 10).collect(),
            }],
        }
    }

    #[test]
    fn bars_stand_over_their_times() {
        let text = door().text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2 + ROWS_ALONE + 2, "{text}");
        assert_eq!(lines[2], format!("  1 │{}{}", " ".repeat(27), "▂".repeat(24)));
        assert_eq!(
            lines[9],
            format!("  0 │{}░░░{}{}{}", "▁".repeat(9), "▁".repeat(15), "█".repeat(24), "▁".repeat(21))
        );
        assert_eq!(lines[10].chars().position(|mark| mark == '▲'), Some(5 + 30));
        assert!(lines[11].trim_start().starts_with("00:00 "), "{text}");
        assert!(lines.iter().all(|line| line.chars().count() <= 100));
    }

    #[test]
    fn other_scales_take_their_values() {
        let mut plot = door();
        plot.curves[0].values = vec![Some(-3.0), None, Some(41.0), Some(f64::NAN)];
        plot.curves.push(Curve::default());
        plot.labels.truncate(4);
        let text = plot.text();
        assert!(text.contains("50 │") && text.contains("-3 │"), "{text}");
        assert!(CurvePlot::default().text().len() < 10);
    }

    #[test]
    fn svg_is_well_formed() {
        let svg = door().svg();
        assert!(svg.contains("<polygon") || svg.contains("<polyline"), "{svg}");
        assert!(svg.contains("&lt;1&gt;") && svg.ends_with("</svg>\n"));
        assert!(!svg.contains("NaN"));
        assert!(CurvePlot::default().svg().ends_with("</svg>\n"));
    }
}
