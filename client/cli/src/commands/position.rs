//! `tidemap position`: where something is, or, with `--flow`, how people move.
//!
//! Invariant: rows are in the order of the times, the most probable cell of each time first; the summary of a time goes
//! to stderr.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::queries::{ModelSelector, PositionForecast, PositionQuery, PositionsHeader, age_nanos};

use super::{Session, files::DrawingArg, times, usage};

mod flow;

pub(super) use flow::source;

use crate::progress::status_line;
use tidemap_formats::{drawing::HeatMap, table::Cell};

#[derive(Debug, Args)]
pub(crate) struct PositionArgs {
    /// Name of the map
    map: String,
    /// Name of the vector
    state: String,
    /// Times
    #[arg(long, required = true, value_name = "TIME,…", value_parser = times::time, value_delimiter = ',')]
    at: Vec<i64>,
    /// Model: hypertime-em[:CLUSTERS] or hypertime-km[:CLUSTERS]
    #[arg(long, value_name = "KIND", default_value = "hypertime-em:3", conflicts_with = "flow")]
    model: ModelSelector,
    /// Edge of a cell in metres [default: 1/64 of the region's longest side, or 1/24 for three coordinates; with --flow
    /// 1, or more for a large region]
    #[arg(long, value_name = "M")]
    resolution: Option<f64>,
    /// Region to predict: lower and upper corner in metres [default: the observed region with a margin]
    #[arg(long, value_name = "X,Y[,Z]:X,Y[,Z]", value_parser = region, allow_hyphen_values = true)]
    region: Option<Region>,
    /// Number of cells per time, the most probable ones, with --flow those with the most people; 0 for all
    #[arg(long, value_name = "N", default_value_t = 10)]
    top: u32,
    /// Also predict how many positions there are in each cell, from each time until this much later [at most: 7d]; with
    /// --flow, the window around each time [default: 10m]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    count: Option<i64>,
    #[command(flatten)]
    flow: flow::FlowArgs,
    #[command(flatten)]
    drawing: DrawingArg,
}

#[derive(Clone, Debug)]
pub(super) struct Region {
    low_m: Vec<f64>,
    high_m: Vec<f64>,
}

fn region(text: &str) -> Result<Region, String> {
    let corner = |text: &str| text.split(',').map(|number| number.trim().parse().ok()).collect::<Option<Vec<f64>>>();
    let corners = text.split_once(':').and_then(|(low, high)| Some((corner(low)?, corner(high)?)));
    match corners {
        Some((low_m, high_m)) if low_m.len() == high_m.len() => Ok(Region { low_m, high_m }),
        _ => Err(format!(
            "{text:?} is not a region: use two corners with the same number of coordinates, such as 0,0:10,5"
        )),
    }
}

pub(crate) async fn run(session: &Session, args: PositionArgs) -> anyhow::Result<ExitCode> {
    if args.resolution.is_some_and(|edge| edge.is_nan() || edge <= 0.0) {
        return Err(usage("--resolution must be above 0"));
    }
    args.drawing.check()?;
    args.flow.check()?;
    if args.drawing.is_wanted() && args.at.len() != 1 {
        return Err(usage("--picture draws one time: give one with --at"));
    }
    if let Some(motion) = args.flow.flow.clone() {
        return flow::run(session, args, motion).await;
    }
    let query = PositionQuery {
        times: args.at.clone(),
        model: Some(args.model),
        region_m: args.region.map(|region| (region.low_m, region.high_m)),
        resolution_m: args.resolution,
        // A drawing needs all cells.
        top: Some(if args.drawing.is_wanted() { 0 } else { args.top }),
        count_window: args.count,
    };
    let mut positions = session.client.positions(&args.map, &args.state, query).await?;
    let header = positions.header().clone();
    let axes = ["x", "y", "z"].into_iter().take(header.counts.len());
    let counted = args.count.map(|_| "expected_count");
    let columns: Vec<&str> = ["time"].into_iter().chain(axes).chain(["probability"]).chain(counted).collect();
    let mut table = session.table(&columns);
    let mut summaries = Vec::new();
    while let Some(forecast) = positions.next().await? {
        let time = args.at.get(forecast.time).copied().unwrap_or_default();
        if args.drawing.is_wanted() {
            let heading = format!("{} at {}", args.state, session.times.heading(time));
            let map = heat_map(&header, &forecast, heading);
            args.drawing.put(|| map.text(), || map.svg())?;
        }
        let listed = match (args.drawing.is_in_terminal(), args.top) {
            (true, _) => 0,
            (false, 0) => usize::MAX,
            (false, top) => top as usize,
        };
        for (middle, probability) in forecast.cells.iter().take(listed) {
            let mut cells = vec![Cell::Time(time)];
            cells.extend(middle.iter().map(|&coordinate| Cell::from(coordinate)));
            cells.push((*probability).into());
            if args.count.is_some() {
                cells.push((probability * forecast.expected_count).into());
            }
            table.row(cells)?;
        }
        summaries.push(summary(&header, &forecast, time, args.count));
    }
    if !args.drawing.is_in_terminal() {
        table.finish()?;
    }
    summaries.iter().for_each(|line| status_line(line));
    Ok(ExitCode::SUCCESS)
}

/// The cells seen from above; those over each other are added up.
fn heat_map(header: &PositionsHeader, forecast: &PositionForecast, title: String) -> HeatMap {
    let axis = |axis: usize| {
        let (low, count) = (header.low_m.get(axis).copied(), header.counts.get(axis).copied());
        (low.unwrap_or_default(), count.unwrap_or(1).max(1) as usize)
    };
    let ((low_x, width), (low_y, height)) = (axis(0), axis(1));
    let mut values = vec![vec![Some(0.0); width]; height];
    let place = |middle: f64, low: f64, count: usize| {
        (((middle - low) / header.resolution_m).floor().max(0.0) as usize).min(count - 1)
    };
    for (middle, probability) in &forecast.cells {
        if let [x, y, ..] = middle[..]
            && let Some(Some(cell)) = values[height - 1 - place(y, low_y, height)].get_mut(place(x, low_x, width))
        {
            *cell += probability;
        }
    }
    let highest = values.iter().flatten().flatten().copied().fold(0.0, f64::max);
    let metres = |low: f64, at: usize| format!("{:.1}", low + at as f64 * header.resolution_m);
    HeatMap {
        title,
        rows: (0..height).rev().map(|row| metres(low_y, row)).collect(),
        columns: (0..width).map(|column| metres(low_x, column)).collect(),
        values,
        range: [0.0, highest],
        unit: "probability of a cell; metres".to_owned(),
        cell_m: Some(header.resolution_m),
        ..HeatMap::default()
    }
}

/// The summary of a time.
fn summary(header: &PositionsHeader, forecast: &PositionForecast, time: i64, window: Option<i64>) -> String {
    const NANOS_PER_SEC: i64 = 1_000_000_000;
    let expected: Vec<String> = forecast.expected_m.iter().map(|coordinate| format!("{coordinate:.3}")).collect();
    let age = header.last_nanos.map(|last| age_nanos(last, time) / NANOS_PER_SEC);
    let counted = window.map(|window| {
        format!("{:.3} positions expected within {} s, ", forecast.expected_count, window / NANOS_PER_SEC)
    });
    format!(
        "{}: {}expected at {} m, outside of the region with {:.4}; from {} positions, the last {} s before",
        time / NANOS_PER_SEC,
        counted.unwrap_or_default(),
        expected.join(", "),
        forecast.outside,
        header.trained_observations,
        age.unwrap_or_default(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heat_map_has_north_at_the_top() {
        let header = PositionsHeader {
            low_m: vec![0.0, 0.0],
            resolution_m: 0.5,
            counts: vec![3, 2],
            observations: 1,
            trained_observations: 1,
            last_nanos: None,
            generation: 1,
        };
        let cells = vec![(vec![1.25, 0.75], 0.5), (vec![0.25, 0.25], 0.25)];
        let map = heat_map(&header, &PositionForecast { cells, ..PositionForecast::default() }, String::new());
        assert_eq!(map.values, [[Some(0.0), Some(0.0), Some(0.5)], [Some(0.25), Some(0.0), Some(0.0)]]);
        assert_eq!((map.rows, map.range), (vec!["0.5".to_owned(), "0.0".to_owned()], [0.0, 0.5]));
    }

    #[test]
    fn regions_are_two_corners() {
        let found = region("-1,2.5:10,5").expect("a region");
        assert_eq!((found.low_m, found.high_m), (vec![-1.0, 2.5], vec![10.0, 5.0]));
        for wrong in ["", "1,2", "1,2:3", "1,2:3,x", "1,2:3,4:5,6"] {
            assert!(region(wrong).is_err(), "{wrong}");
        }
    }
}
