//! `tidemap position --flow`: how many people are in which cells, and where they go.
//!
//! Invariant: rows are in the order of the times, the cell with the most people of each time first; the summary goes to
//! stderr.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use tidemap_client::queries::{FlowForecast, FlowSource, Flows, PositionRegion};
use tidemap_formats::{
    MapPicture, PictureCell, PictureValue,
    drawing::HeatMap,
    nav2::{self, GridMode},
    table::Cell,
};

use super::{PositionArgs, Region};
use crate::{
    commands::{Session, files, usage},
    progress::status_line,
};

/// Arrows are drawn in cells with at least this share of the most people of a cell.
const ARROW_MIN: f64 = 0.05;
const NANOS_PER_SEC: i64 = 1_000_000_000;

#[derive(Debug, Args)]
pub(super) struct FlowArgs {
    /// Predict flows: how many people there are, and where they go. STATE has their direction, observed at the times of
    /// their positions: an angle, or a vector with their velocity
    #[arg(long, value_name = "STATE")]
    pub(super) flow: Option<String>,
    /// Number of directions, 4 to 36 [default: 8]
    #[arg(long, value_name = "N", requires = "flow", value_parser = clap::value_parser!(u32).range(4..=36))]
    directions: Option<u32>,
    /// Write expected detections as a costmap of Nav2: a PGM file, with its YAML file beside it
    #[arg(long, value_name = "FILE.pgm", requires = "flow")]
    mask: Option<PathBuf>,
    /// Detections in a cell that are the highest cost of the mask [default: the most in a cell]
    #[arg(long, value_name = "N", requires = "mask")]
    mask_full: Option<f64>,
}

impl FlowArgs {
    /// Refuses values that are out of range.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let is_pgm = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "pgm");
        if self.mask.as_ref().is_some_and(|path| !is_pgm(path)) {
            return Err(usage("--mask writes a file that ends in .pgm, and a .yaml file beside it"));
        }
        match self.mask_full {
            Some(full) if !(full.is_finite() && full > 0.0) => Err(usage("--mask-full must be a number above 0")),
            _ => Ok(()),
        }
    }
}

pub(super) async fn run(session: &Session, args: PositionArgs, motion: String) -> anyhow::Result<ExitCode> {
    let PositionArgs { map, state, at, region, resolution, top, count, drawing, flow, .. } = args;
    if flow.mask.is_some() && at.len() != 1 {
        return Err(usage("--mask is of one time: give one with --at"));
    }
    let source = source(state, motion, region, resolution, flow.directions);
    let name = source.state.clone();
    let flows = session.client.flows(&map, source, &at, count).await?;
    let mut table = session.table(&["time", "x", "y", "expected_count", "direction_rad", "share", "arrow"]);
    for (&time, cells) in at.iter().zip(&flows.times) {
        if drawing.is_wanted() {
            let heading = format!("flow of {name} at {}", session.times.heading(time));
            let map = heat_map(&flows, cells, heading);
            drawing.put(|| map.text(), || map.svg())?;
        }
        if let Some(path) = &flow.mask {
            let image_name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let picture = mask(&flows, cells, flow.mask_full);
            let written = nav2::write(&picture, &image_name, GridMode::Scale, nav2::Thresholds::default())?;
            files::write(path, &written.image)?;
            files::write(&path.with_extension("yaml"), &written.yaml)?;
        }
        let mut rows: Vec<&FlowForecast> = cells.iter().collect();
        rows.sort_by(|one, other| other.expected_count.total_cmp(&one.expected_count));
        let listed = match (drawing.is_in_terminal(), top) {
            (true, _) => 0,
            (false, 0) => usize::MAX,
            (false, top) => top as usize,
        };
        for forecast in rows.into_iter().take(listed) {
            let [x, y] = flows.raster.middle_m(forecast.cell);
            let (direction_rad, share) = forecast.likeliest();
            let arrow = HeatMap::arrow_character(direction_rad).to_string();
            let numbers = [x, y, forecast.expected_count, direction_rad, share].map(Cell::from);
            table.row([Cell::Time(time)].into_iter().chain(numbers).chain([Cell::from(arrow.as_str())]).collect())?;
        }
    }
    if !drawing.is_in_terminal() {
        table.finish()?;
    }
    for (time, cells) in at.iter().zip(&flows.times) {
        let all: f64 = cells.iter().map(|cell| cell.expected_count).sum();
        status_line(&format!("{}: {all:.3} detections expected in {} cells", time / NANOS_PER_SEC, cells.len()));
    }
    let Flows { detections, rhythmic_cells, .. } = flows;
    status_line(&format!("from {detections} detections with a direction; {rhythmic_cells} cells have a rhythm"));
    Ok(ExitCode::SUCCESS)
}

/// The detections of a command.
pub(in crate::commands) fn source(
    state: String,
    motion_state: String,
    region: Option<Region>,
    edge_m: Option<f64>,
    directions: Option<u32>,
) -> FlowSource {
    FlowSource {
        state,
        motion_state,
        region: region.map(|Region { low_m, high_m }| PositionRegion { low_m, high_m }),
        edge_m,
        directions: directions.unwrap_or_default() as usize,
    }
}

/// The most people of a cell.
fn highest_count(cells: &[FlowForecast]) -> f64 {
    cells.iter().map(|cell| cell.expected_count).fold(0.0, f64::max)
}

/// The number of people in each cell as shades, and their directions as arrows.
fn heat_map(flows: &Flows, cells: &[FlowForecast], title: String) -> HeatMap {
    let [width, height] = flows.raster.counts.map(|count| count.max(1));
    let mut values = vec![vec![Some(0.0); width]; height];
    let mut arrows = vec![vec![None; width]; height];
    let highest = highest_count(cells);
    for forecast in cells {
        let (row, column) = (height - 1 - forecast.cell / width, forecast.cell % width);
        values[row][column] = Some(forecast.expected_count);
        if forecast.expected_count >= ARROW_MIN * highest {
            arrows[row][column] = Some(forecast.likeliest().0);
        }
    }
    let metres = |axis: usize, at: usize| format!("{:.1}", flows.raster.low_m[axis] + at as f64 * flows.raster.edge_m);
    HeatMap {
        title,
        rows: (0..height).rev().map(|row| metres(1, row)).collect(),
        columns: (0..width).map(|column| metres(0, column)).collect(),
        values,
        arrows,
        range: [0.0, highest],
        unit: "expected detections of a cell; metres".to_owned(),
        cell_m: Some(flows.raster.edge_m),
    }
}

/// The number of people in each cell as a cost from 0 to 1; `full` people are the highest.
fn mask(flows: &Flows, cells: &[FlowForecast], full: Option<f64>) -> MapPicture {
    let full = full.unwrap_or_else(|| highest_count(cells)).max(f64::MIN_POSITIVE);
    let mut picture = vec![PictureCell::Static { probability: 0.0 }; flows.raster.cells()];
    for forecast in cells {
        let cost = (forecast.expected_count / full).min(1.0) as f32;
        picture[forecast.cell] = PictureCell::Static { probability: cost };
    }
    let [low_x, low_y] = flows.raster.low_m;
    let [width, height] = flows.raster.counts.map(|count| u32::try_from(count).unwrap_or(u32::MAX));
    MapPicture {
        resolution_m: flows.raster.edge_m,
        origin_m: [low_x, low_y, 0.0],
        min_cell: [0; 3],
        size_cells: [width, height, 1],
        cells: picture,
        value: PictureValue::Probability,
        levels: (0.0, 1.0),
    }
}

#[cfg(test)]
mod tests {
    use tidemap_formats::nav2::{read, read_settings};

    use super::*;

    fn flows() -> Flows {
        let raster = tidemap_client::queries::FlowRaster { low_m: [-1.0, 2.0], edge_m: 0.5, counts: [3, 2] };
        let cell = |cell: usize, expected_count: f64, shares: Vec<f64>| FlowForecast { cell, expected_count, shares };
        let cells = vec![cell(0, 4.0, vec![1.0, 0.0, 0.0, 0.0]), cell(5, 1.0, vec![0.0, 0.9, 0.1, 0.0])];
        Flows { raster, directions: 4, detections: 9, rhythmic_cells: 1, generation: 1, times: vec![cells] }
    }

    #[test]
    fn a_drawing_has_north_at_the_top() {
        let flows = flows();
        let map = heat_map(&flows, &flows.times[0], String::new());
        assert_eq!(map.values, [[Some(0.0), Some(0.0), Some(1.0)], [Some(4.0), Some(0.0), Some(0.0)]]);
        assert_eq!(map.arrows[1][0], Some(0.0));
        assert!(map.text().contains('↑') && map.text().contains('→'), "{}", map.text());
    }

    #[test]
    fn a_mask_is_read_as_costs_by_a_map_server() {
        let flows = flows();
        let written =
            nav2::write(&mask(&flows, &flows.times[0], None), "m.pgm", GridMode::Scale, nav2::Thresholds::default());
        let written = written.expect("a mask");
        let grid = read(&read_settings(written.yaml.as_bytes()).expect("settings"), &written.image).expect("a grid");
        assert_eq!((grid.origin_m, grid.size_cells), ([-1.0, 2.0], [3, 2]));
        assert_eq!(grid.cells[0], nav2::GridCell::Occupied);
        assert!(matches!(grid.cells[5], nav2::GridCell::Between { percent: 24..=26 }), "{:?}", grid.cells[5]);
        assert_eq!(grid.cells[1], nav2::GridCell::Free);
    }
}
