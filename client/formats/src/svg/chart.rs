//! Parts of charts: scales with round ticks, a panel with series over time, and keys of a legend.

use super::Svg;

/// Width of every chart.
pub const CHART_WIDTH: f64 = 860.0;
/// Font size of charts.
pub const FONT_SIZE: f64 = 13.0;

/// A bold heading.
pub const HEADING: &str = "text-anchor=\"start\" font-weight=\"bold\"";
const GRID: &str = "stroke=\"#e4e4e4\"";
/// Colours that people with any kind of colour vision can distinguish (M. Okabe and K. Ito, "Color universal design",
/// 2008).
const COLOURS: [&str; 7] = ["#000000", "#0072b2", "#d55e00", "#56b4e9", "#009e73", "#e69f00", "#cc79a7"];
const DASHES: [&str; 3] = ["", " stroke-dasharray=\"6 3\"", " stroke-dasharray=\"2 2\""];

/// The style of the line of a series: a colour of its own, then the same colours dashed.
pub fn series_style(index: usize) -> String {
    let (colour, dash) = (COLOURS[index % COLOURS.len()], DASHES[index / COLOURS.len() % DASHES.len()]);
    format!("stroke=\"{colour}\" stroke-width=\"1.6\"{dash}")
}

/// A scale from 0 to a round number, with about five round ticks.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    tick: f64,
    ticks: u32,
}

impl Scale {
    /// The scale for values up to `max`; its ticks are 1, 2 or 5 times a power of ten apart.
    pub fn up_to(max: f64) -> Self {
        let mut tick = 1.0;
        if max.is_finite() && max > 0.0 {
            let power = 10_f64.powf((max / 5.0).log10().floor());
            let steps = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * power >= max / 5.0);
            tick = steps.unwrap_or(10.0) * power;
        }
        Self { tick, ticks: (max / tick).ceil().max(1.0) as u32 }
    }

    /// The end of the scale.
    pub fn end(self) -> f64 {
        self.tick * f64::from(self.ticks)
    }

    /// The ticks, both ends included.
    pub fn ticks(self) -> impl Iterator<Item = f64> {
        (0..=self.ticks).map(move |at| f64::from(at) * self.tick)
    }
}

/// A number with four significant digits.
pub fn number(number: f64) -> String {
    let rounded: f64 = format!("{number:.3e}").parse().unwrap_or(number);
    let is_short = rounded == 0.0 || (1e-4..1e7).contains(&rounded.abs());
    if is_short { rounded.to_string() } else { format!("{rounded:e}") }
}

/// An upper estimate of the width of a text: 0.63 is the largest mean width of letters, as a share of the font size, of
/// all common fonts.
pub fn text_width(text: &str, font_size: f64) -> f64 {
    0.63 * font_size * text.chars().count() as f64
}

/// A panel in which series are drawn over `steps` equal steps of time.
#[derive(Clone, Copy, Debug)]
pub struct Panel {
    /// Left, top, width and height.
    pub area: [f64; 4],
    /// Number of steps.
    pub steps: usize,
    /// The scale of the values.
    pub scale: Scale,
}

impl Panel {
    /// The horizontal position of a point in time, in steps.
    pub fn x(&self, step: f64) -> f64 {
        let [left, _, width, _] = self.area;
        left + step / self.steps.max(1) as f64 * width
    }

    /// The bottom edge.
    pub fn bottom(&self) -> f64 {
        self.area[1] + self.area[3]
    }

    /// Values above the scale lie at its end.
    fn y(&self, value: f64) -> f64 {
        self.bottom() - self.area[3] * (value / self.scale.end()).min(1.0)
    }

    /// Draws the grid with the numbers of the scale.
    pub fn draw_grid(&self, svg: &mut Svg) {
        let [left, _, width, _] = self.area;
        for value in self.scale.ticks() {
            svg.line([left, self.y(value), left + width, self.y(value)], GRID);
            svg.text([left - 6.0, self.y(value) + 4.0], &number(value), "text-anchor=\"end\"");
        }
    }

    /// Writes a label below a point in time.
    pub fn label(&self, svg: &mut Svg, step: f64, text: &str) {
        svg.text([self.x(step), self.bottom() + 19.0], text, "text-anchor=\"middle\"");
    }

    /// Draws a series: a value for each step, at the middle of the step, with a gap where there is none.
    pub fn draw_series(&self, svg: &mut Svg, values: impl IntoIterator<Item = Option<f64>>, style: &str) {
        let points: Vec<Option<[f64; 2]>> = (0..)
            .zip(values)
            .map(|(step, value): (u32, Option<f64>)| Some([self.x(f64::from(step) + 0.5), self.y(value?)]))
            .collect();
        for run in points.split(Option::is_none).filter(|run| run.len() > 1) {
            svg.polyline(run.iter().copied().flatten(), style);
        }
    }
}

/// Draws a key of a legend, a line and its meaning, and returns where the next key of the row starts.
pub fn draw_key(svg: &mut Svg, [left, middle]: [f64; 2], style: &str, meaning: &str) -> f64 {
    svg.line([left, middle, left + 30.0, middle], style);
    svg.text([left + 38.0, middle + 4.0], meaning, "text-anchor=\"start\"");
    left + 62.0 + text_width(meaning, FONT_SIZE)
}
