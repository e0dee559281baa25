//! Predictions as a drawing: a curve for each of a few states, a strip for each of many.
//!
//! Invariant: every state is drawn; of more times than fit, neighbours are averaged.

use tidemap_client::queries::PredictionRun;
use tidemap_formats::{
    drawing::{Curve, CurvePlot, HeatMap},
    table::numbers::number,
};

use crate::commands::{Session, usage};

/// Maximum number of states that are drawn as curves.
const CURVES_MAX: usize = 12;
/// Maximum number of values of a drawing.
const DRAWN_MAX: usize = 1_000_000;
/// Maximum numbers of columns of a strip, in the terminal and in a file.
const COLUMNS_MAX: [usize; 2] = [36, 288];

/// Predictions that are drawn.
pub(super) struct Drawn<'a> {
    session: &'a Session,
    plot: CurvePlot,
    /// Places of the times in their order.
    order: Vec<usize>,
    times: Vec<i64>,
}

impl<'a> Drawn<'a> {
    pub(super) fn new(session: &'a Session) -> Self {
        Self { session, plot: CurvePlot::default(), order: Vec::new(), times: Vec::new() }
    }

    pub(super) fn add(&mut self, run: &PredictionRun, name: &str, times: &[i64]) -> anyhow::Result<()> {
        if self.order.is_empty() {
            self.begin(times);
        }
        if self.plot.curves.last().is_none_or(|curve| curve.name != name) {
            self.plot.curves.push(Curve {
                name: name.to_owned(),
                values: vec![None; times.len()],
                band: vec![None; times.len()],
                marks: Vec::new(),
            });
        }
        if self.plot.curves.len() * times.len() > DRAWN_MAX {
            return Err(usage(format!(
                "--picture draws at most {DRAWN_MAX} values: name fewer states, or a longer --step"
            )));
        }
        let mut places = vec![0; times.len()];
        self.order.iter().enumerate().for_each(|(place, &at)| places[at] = place);
        if let Some(curve) = self.plot.curves.last_mut() {
            for (i, &value) in run.probabilities.iter().enumerate() {
                let Some(&place) = places.get(run.first_time + i) else { continue };
                curve.values[place] = Some(value);
                curve.band[place] = run.lower.get(i).zip(run.upper.get(i)).map(|(&lower, &upper)| [lower, upper]);
            }
        }
        Ok(())
    }

    fn begin(&mut self, times: &[i64]) {
        self.order = (0..times.len()).collect();
        self.order.sort_by_key(|&at| times[at]);
        self.times = self.order.iter().map(|&at| times[at]).collect();
        self.plot.labels = self.times.iter().map(|&time| self.session.times.label(time)).collect();
        let ends =
            [self.times.first(), self.times.last()].map(|time| time.map(|&time| self.session.times.heading(time)));
        if let [Some(first), Some(last)] = ends {
            self.plot.title = format!("predicted from {first} to {last}");
        }
    }

    pub(super) fn text(&self) -> String {
        if self.plot.curves.len() > CURVES_MAX { self.strips(COLUMNS_MAX[0]).text() } else { self.plot.text() }
    }

    pub(super) fn svg(&self) -> String {
        if self.plot.curves.len() > CURVES_MAX { self.strips(COLUMNS_MAX[1]).svg() } else { self.plot.svg() }
    }

    /// A row for each state, in their order, and at most `columns_max` columns.
    fn strips(&self, columns_max: usize) -> HeatMap {
        let step = self.times.len().div_ceil(columns_max).max(1);
        let mean = |values: &[Option<f64>]| {
            let known: Vec<f64> = values.iter().flatten().copied().collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        let rows = self.plot.curves.iter().map(|curve| {
            let values: Vec<Option<f64>> = curve.values.chunks(step).map(mean).collect();
            strip(&curve.name, values)
        });
        let (rows, values): (Vec<String>, Vec<Vec<Option<f64>>>) = rows.unzip();
        let are_probabilities = self.plot.curves.iter().zip(&rows).all(|(curve, row)| curve.name == *row);
        let unit = if are_probabilities { "probability" } else { "probability, or within the range beside the name" };
        HeatMap {
            title: self.plot.title.clone(),
            rows,
            columns: self.plot.labels.iter().step_by(step).cloned().collect(),
            range: [0.0, 1.0],
            unit: unit.to_owned(),
            values,
            ..HeatMap::default()
        }
    }
}

/// The row of a state: probabilities as they are, other numbers from the least to the greatest, which the name shows.
/// With one scale for all, a temperature would show every door as shut.
fn strip(name: &str, values: Vec<Option<f64>>) -> (String, Vec<Option<f64>>) {
    let known = || values.iter().flatten().copied();
    if known().all(|value| (0.0..=1.0).contains(&value)) {
        return (name.to_owned(), values);
    }
    let (least, greatest) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
    let span = greatest - least;
    let scaled = |value: f64| if span > 0.0 { (value - least) / span } else { 0.5 };
    let name = format!("{name} ({}..{})", number(least), number(greatest));
    (name, values.into_iter().map(|value| value.map(scaled)).collect())
}

#[test]
fn numbers_beside_doors_have_a_scale_of_their_own() {
    let door = vec![Some(0.0), Some(0.9), None];
    assert_eq!(strip("door", door.clone()), ("door".to_owned(), door));
    let (name, values) = strip("hall", vec![Some(17.5), Some(21.25), Some(19.375)]);
    assert_eq!((name.as_str(), values), ("hall (17.5..21.25)", vec![Some(0.0), Some(1.0), Some(0.5)]));
    assert_eq!(strip("x", vec![Some(3.0)]).1, [Some(0.5)]);
}
