//! `tidemap position`.
//!
//! Invariant: rows are in the order of the times, the most probable cell of each time first; the summary of a time goes
//! to stderr.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::queries::{ModelSelector, PositionForecast, PositionQuery, PositionsHeader};

use super::{Session, times, usage};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

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
    #[arg(long, value_name = "KIND", default_value = "hypertime-em:3")]
    model: ModelSelector,
    /// Edge of a cell in metres [default: 1/64 of the region's longest side, or 1/24 for three coordinates]
    #[arg(long, value_name = "M")]
    resolution: Option<f64>,
    /// Region to predict: lower and upper corner in metres [default: the observed region with a margin]
    #[arg(long, value_name = "X,Y[,Z]:X,Y[,Z]", value_parser = region, allow_hyphen_values = true)]
    region: Option<Region>,
    /// Number of cells per time, the most probable ones; 0 for all
    #[arg(long, value_name = "N", default_value_t = 10)]
    top: u32,
    /// Also predict how many positions there are in each cell, from each time until this much later [at most: 7d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    count: Option<i64>,
}

#[derive(Clone, Debug)]
struct Region {
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
    let query = PositionQuery {
        times: args.at.clone(),
        model: Some(args.model),
        region_m: args.region.map(|region| (region.low_m, region.high_m)),
        resolution_m: args.resolution,
        top: Some(args.top),
        count_window: args.count,
    };
    let mut positions = session.client.positions(&args.map, &args.state, query).await?;
    let header = positions.header().clone();
    let axes = ["x", "y", "z"].into_iter().take(header.counts.len());
    let counted = args.count.map(|_| "expected_count");
    let columns: Vec<&str> = ["time"].into_iter().chain(axes).chain(["probability"]).chain(counted).collect();
    let mut table = session.table(&columns);
    let mut told = Vec::new();
    while let Some(forecast) = positions.next().await? {
        let time = args.at.get(forecast.time).copied().unwrap_or_default();
        for (middle, probability) in &forecast.cells {
            let mut cells = vec![Cell::Time(time)];
            cells.extend(middle.iter().map(|&coordinate| Cell::from(coordinate)));
            cells.push((*probability).into());
            if args.count.is_some() {
                cells.push((probability * forecast.expected_count).into());
            }
            table.row(cells)?;
        }
        told.push(summary(&header, &forecast, time, args.count));
    }
    table.finish()?;
    told.iter().for_each(|line| status_line(line));
    Ok(ExitCode::SUCCESS)
}

/// The summary of a time.
fn summary(header: &PositionsHeader, forecast: &PositionForecast, time: i64, window: Option<i64>) -> String {
    const NANOS_PER_SEC: i64 = 1_000_000_000;
    let expected: Vec<String> = forecast.expected_m.iter().map(|coordinate| format!("{coordinate:.3}")).collect();
    let age = header.last_nanos.map(|last| time.saturating_sub(last) / NANOS_PER_SEC);
    let counted = window.map(|window| {
        format!("{:.3} positions expected within {} s, ", forecast.expected_count, window / NANOS_PER_SEC)
    });
    format!(
        "{}: {}expected at {} m, outside of the region with {:.4}; from {} positions, the last {} s before",
        time / NANOS_PER_SEC,
        counted.unwrap_or_default(),
        expected.join(", "),
        forecast.outside,
        header.fitted_observations,
        age.unwrap_or_default(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_two_corners() {
        let found = region("-1,2.5:10,5").expect("a region");
        assert_eq!((found.low_m, found.high_m), (vec![-1.0, 2.5], vec![10.0, 5.0]));
        for wrong in ["", "1,2", "1,2:3", "1,2:3,x", "1,2:3,4:5,6"] {
            assert!(region(wrong).is_err(), "{wrong}");
        }
    }
}
