//! `tidemap tour`.
//!
//! Invariant: goals are in driving order; for a tour without goals the reason is reported.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use tidemap_client::{
    exploration::{GOALS_MAX, Sensor, Tour, TourQuery, TourQuestion, TourStep},
    queries::{GridOutput, GridQuery, ModelSelector},
};

use super::{Session, files, grid, point::Point, predict::check_for_cells, times};
use crate::progress::status_line;
use tidemap_formats::{PictureValue, table::Cell, tour_svg};

#[derive(Debug, Args)]
pub(crate) struct TourArgs {
    /// Name of the map
    map: String,
    /// Time of the tour
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Maximum number of goals
    #[arg(long, value_name = "N", default_value_t = TourQuestion::default().goals as u32,
        value_parser = clap::value_parser!(u32).range(1..=GOALS_MAX as i64))]
    count: u32,
    /// Position where the robot starts and to which it returns, metres [default: the map's charger]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    start: Option<Point>,
    /// The robot does not return from its last goal
    #[arg(long)]
    open: bool,
    /// Maximum duration of the tour, including the return
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    budget: Option<i64>,
    /// Range of the robot's sensor, metres
    #[arg(long, value_name = "M", default_value_t = Sensor::default().range_m)]
    range: f64,
    /// Height of the sensor, metres
    #[arg(long, value_name = "M", allow_hyphen_values = true, default_value_t = Sensor::default().height_m)]
    sensor_height: f64,
    /// Distance between candidate goals, metres
    #[arg(long, value_name = "M", default_value_t = TourQuestion::default().spacing_m)]
    spacing: f64,
    /// Radius of the robot, metres
    #[arg(long, value_name = "M", default_value_t = TourQuestion::default().travel.radius_m)]
    robot_radius: f64,
    /// Height of the robot, metres
    #[arg(long, value_name = "M", default_value_t = TourQuestion::default().travel.z_max_m)]
    robot_height: f64,
    /// Speed of the robot, metres per second
    #[arg(long, value_name = "M/S", default_value_t = TourQuestion::default().speed_m_per_s)]
    speed: f64,
    /// Time to observe at each goal
    #[arg(long, value_name = "DURATION", value_parser = times::duration_or_none, default_value = "60s")]
    observing: i64,
    /// Model of the grid: auto, mean, latest or spectral, each optionally with +persistence or +memory
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Draws the tour over the predicted map as SVG
    #[arg(long, value_name = "FILE.svg")]
    picture: Option<PathBuf>,
}

const COLUMNS: [&str; 6] = ["step", "x", "y", "information_bits", "reachability", "arrival_secs"];

pub(crate) async fn run(session: &Session, args: TourArgs) -> anyhow::Result<ExitCode> {
    check_for_cells(args.model)?;
    files::check_picture(args.picture.as_deref())?;
    let query = TourQuery {
        map: args.map.clone(),
        time_nanos: args.at,
        count: args.count,
        start_m: args.start.map(|Point(at)| at),
        is_open: args.open,
        sensor: Sensor { range_m: args.range, height_m: args.sensor_height, ..Sensor::default() },
        model: args.model,
        spacing_m: Some(args.spacing),
        robot_radius_m: Some(args.robot_radius),
        robot_height_m: Some(args.robot_height),
        speed_m_per_s: Some(args.speed),
        observing_nanos: Some(args.observing),
        budget_nanos: args.budget,
    };
    let tour = session.client.plan_tour(&query).await?;
    if let Some(path) = &args.picture {
        let svg = draw(session, &query, args.robot_height, &tour).await?;
        files::write(path, svg)?;
    }
    if let Some(reason) = &tour.no_tour {
        status_line(&format!("no tour: {reason}"));
    } else {
        let Tour { length_m, duration_secs, information_bits, candidates, .. } = &tour;
        status_line(&format!(
            "{length_m:.1} m in {duration_secs:.0} s for {information_bits:.0} bits, chosen from {candidates} places"
        ));
    }
    let row = |(step, goal): (u64, &TourStep)| {
        let TourStep { at_m: [x, y], information_bits, reachability, arrival_secs } = *goal;
        let mut cells = vec![Cell::Count(step)];
        cells.extend([x, y, information_bits, reachability, arrival_secs].map(Cell::from));
        cells
    };
    session.print(&COLUMNS, (1_u64..).zip(&tour.steps).map(row))
}

/// Draws the tour over the map predicted for its time.
async fn draw(session: &Session, query: &TourQuery, height_m: f64, tour: &Tour<String>) -> anyhow::Result<String> {
    let map = session.client.map(&query.map).await?;
    let start = query.start_m.or(map.charger_m);
    let grid = GridQuery {
        map: query.map.clone(),
        time_nanos: query.time_nanos,
        model: query.model,
        region: grid::predict::heights(&map, TourQuestion::default().travel.z_min_m, height_m),
        is_projected: true,
        output: GridOutput::Probability,
    };
    let predicted = session.client.predict_grid(&grid).await?.whole().await?;
    let picture = grid::predict::picture(&predicted, PictureValue::Probability);
    let goals: Vec<[f64; 2]> = tour.steps.iter().map(|step| step.at_m).collect();
    Ok(tour_svg::write(&picture, start, &goals, &tour.path_m)?)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        tour: TourArgs,
    }

    #[test]
    fn a_plain_tour_has_the_defaults_of_the_planner() {
        let Line { tour } = Line::parse_from(["tour", "office", "--at", "2025-03-11T10:00:00Z"]);
        assert_eq!(tour.observing as f64 / 1e9, TourQuestion::default().observation_secs);
        assert_eq!(tour.count as usize, TourQuestion::default().goals);
    }
}
