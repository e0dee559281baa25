//! `tidemap-bench hall`: sends the scans of a robot in a hall with known walls, and compares the learned grid with the
//! walls.
//!
//! Invariant: the daemon receives measured ranges and reported poses only; the truth comes from exact ranges and true
//! poses. The grid is compared at times after the data.

use std::{collections::HashMap, path::PathBuf, time::Instant};

use clap::Args;
use tidemap_client::{
    Client,
    maps::{GridSpec, NewMap},
    observe::{
        Producer, ProducerOptions,
        scan::{Isometry3, RangeScan, Scan, Translation3, UnitQuaternion},
    },
    queries::{GridQuery, WholeGrid},
};
use tidemap_formats::table::Cell;
use tidemap_sim::{CellShare, Hall, HallOptions, HallScan, HallScore, HallThing, HallTruth, TableScore};
use tidemap_terminal::progress::{Bar, status_line};

use super::{Figures, updated};

#[derive(Clone, Debug, Args)]
pub(crate) struct HallArgs {
    /// Days, from a Monday on
    #[arg(long, value_name = "N", default_value_t = 28, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// Places of a patrol at which both scanners scan
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    stops: u32,
    /// Beams of a scan
    #[arg(long, value_name = "N", default_value_t = 360, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    beams: u32,
    /// Maximum distance of the reported pose from the true pose, metres
    #[arg(long, value_name = "METRES", default_value_t = 0.1)]
    drift: f64,
    /// Seed of the patrols
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// A grid with layers of height instead of a flat one; a column counts as its most probable layer
    #[arg(long)]
    layers: bool,
    /// Writes each cell as a line of CSV: x, y, thing, ends of beams in it, distance from things, probability
    #[arg(long, value_name = "PATH")]
    cells: Option<PathBuf>,
    /// Does not delete the map
    #[arg(long)]
    keep: bool,
}

/// Length of a cell's edge.
const RESOLUTION_M: f64 = 0.1;
/// The hour in which walls are compared: the table is not there.
const WALL_HOUR: i32 = 15;
/// The hour of the night in which the table has to be absent.
const NIGHT_HOUR: i32 = 2;
/// The hour in which the table has to be there.
const TABLE_HOUR: i32 = 10;
/// Minutes after the hour.
const PAST_HOUR: i32 = 15;
/// The truth is noted for these days: later ones show the same.
const NOTED_DAYS: u32 = 1;

impl HallArgs {
    pub(super) fn keeps(&self) -> bool {
        self.keep
    }

    /// The map of the scans.
    pub(super) fn new_map(&self, name: String) -> NewMap {
        let grid = GridSpec { is_flat: !self.layers, ..GridSpec::new(RESOLUTION_M) };
        NewMap { name, time_zone: Some(self.options().zone), grid: Some(grid), ..NewMap::default() }
    }

    fn options(&self) -> HallOptions {
        let Self { seed, stops, beams, drift, .. } = *self;
        HallOptions { seed, stops, beams, drift_m: drift, ..HallOptions::default() }
    }
}

pub(super) async fn run(client: &Client, map: &str, args: &HallArgs) -> anyhow::Result<Figures> {
    let hall = Hall::new(args.options())?;
    let mut truth = hall.truth();
    status_line(&format!("sending {} days of scans to map {map}", args.days));
    let began = Instant::now();
    let scans = send(client, map, &hall, args.days, &mut truth).await?;
    let sent_secs = began.elapsed().as_secs_f64();
    let job = updated(client, map).await?;

    // The next working day after the data.
    let day = (args.days..).find(|&day| hall.is_working_day(day)).unwrap_or(args.days);
    let at = |hour: i32| hall.utc_nanos(day, hour * 60 + PAST_HOUR);
    let learned = grid(client, map, at(WALL_HOUR)).await?;
    let score = HallScore::new(&truth, |cell| learned.get(&cell).copied());
    score.to_string().lines().for_each(status_line);
    if let Some(path) = &args.cells {
        std::fs::write(path, cells(&truth, &learned))?;
    }
    let mut table = Vec::new();
    for hour in 0..24 {
        let learned = grid(client, map, at(hour)).await?;
        let score = TableScore::new(&truth, |cell| learned.get(&cell).copied());
        status_line(&format!("table at {hour:02}:{PAST_HOUR}: occupied {}; free {}", score.occupied, score.free));
        table.push((hour, score));
    }
    let table_at = |wanted: i32| table.iter().find(|(hour, _)| *hour == wanted).map(|(_, score)| *score);
    let percent = |share: CellShare| Cell::from(100.0 * share.share());
    let mut figures = vec![
        ("days", Cell::from(u64::from(args.days))),
        ("scans", scans.into()),
        ("sent_secs", sent_secs.into()),
        ("update_secs", Cell::Secs(job.elapsed_nanos)),
        ("wall_cells", u64::from(score.recall().among).into()),
        ("walls_percent", percent(score.recall())),
        ("walls_in_place_percent", percent(score.recall_in_place())),
    ];
    figures.extend(score.walls.iter().map(|(thing, share)| (column(*thing), percent(*share))));
    figures.extend([
        ("free_cells", u64::from(score.false_walls.among).into()),
        ("false_walls_percent", percent(score.false_walls)),
        ("free_percent", percent(score.free)),
        ("hidden_walls", u64::from(score.hidden_walls).into()),
        ("table_free_at_night_percent", Cell::maybe(table_at(NIGHT_HOUR).map(|score| 100.0 * score.free.share()))),
        ("table_at_10_percent", Cell::maybe(table_at(TABLE_HOUR).map(|score| 100.0 * score.occupied.share()))),
    ]);
    Ok(figures)
}

fn column(thing: HallThing) -> &'static str {
    match thing {
        HallThing::OuterWall => "outer_walls_percent",
        HallThing::CorridorWall => "corridor_walls_percent",
        HallThing::RoomWall => "room_walls_percent",
        HallThing::Pillar => "pillars_percent",
        HallThing::LowShelf => "low_shelves_percent",
        HallThing::HighBoard => "high_boards_percent",
        HallThing::DarkWall => "dark_walls_percent",
        HallThing::ShinyWall => "shiny_walls_percent",
        HallThing::Table => "table_percent",
    }
}

/// Sends all scans in order of time; returns their number.
async fn send(client: &Client, map: &str, hall: &Hall, days: u32, truth: &mut HallTruth) -> anyhow::Result<u64> {
    let options = ProducerOptions { nightly: true, ..ProducerOptions::new("robot", "", map) };
    let mut producer = Producer::open(client, options).await?;
    let bar = Bar::count("days sent");
    let mut scans = 0;
    for day in 0..days {
        for patrol in 0..hall.patrols(day) {
            for scan in hall.patrol(day, patrol) {
                if day < NOTED_DAYS {
                    truth.note(&scan);
                }
                producer.send_scan(scan.utc_nanos, Scan::Ranges(measured(&scan))).await?;
                scans += 1;
            }
        }
        bar.set_of(u64::from(day) + 1, u64::from(days));
    }
    bar.clear();
    producer.close().await?;
    let refused = producer.take_refusals();
    anyhow::ensure!(refused.is_empty(), "the daemon refused {} scans: {}", refused.len(), refused[0].detail);
    Ok(scans)
}

/// A scan as the robot sends it.
fn measured(scan: &HallScan) -> RangeScan {
    let [x, y] = scan.reported_pose.place_m;
    let rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, scan.reported_pose.yaw_rad);
    RangeScan {
        pose: Isometry3::from_parts(Translation3::new(x, y, scan.scanner.height_m), rotation),
        angle_min_rad: scan.scanner.angle_min_rad as f32,
        angle_increment_rad: scan.angle_increment_rad as f32,
        ranges_m: scan.ranges_m.iter().map(|&range| range as f32).collect(),
        max_range_m: scan.scanner.range_m as f32,
        ..RangeScan::default()
    }
}

/// The known cells at a time, each column as its most probable layer.
async fn grid(client: &Client, map: &str, time_nanos: i64) -> anyhow::Result<HashMap<[i32; 2], f64>> {
    let query = GridQuery { map: map.to_owned(), time_nanos, is_projected: true, ..GridQuery::default() };
    let WholeGrid { tiles, .. } = client.predict_grid(&query).await?.whole().await?;
    let mut known = HashMap::new();
    for tile in tiles {
        for (place, cell) in (0..64).zip(tile.cells.iter()) {
            let index = [tile.place[0] * 8 + place % 8, tile.place[1] * 8 + place / 8];
            known.extend(cell.value().map(|value| (index, f64::from(value))));
        }
    }
    Ok(known)
}

/// The cells as CSV.
fn cells(truth: &HallTruth, learned: &HashMap<[i32; 2], f64>) -> String {
    let mut text = "x,y,thing,ends,passed,distance_m,probability\n".to_owned();
    for cell in truth.cells() {
        let [x, y] = cell.index;
        let thing = cell.thing.map_or("", HallThing::name);
        let probability = learned.get(&cell.index).map_or_else(String::new, ToString::to_string);
        text.push_str(&format!(
            "{x},{y},{thing},{},{},{:.3},{probability}\n",
            cell.ends, cell.is_passed, cell.distance_m
        ));
    }
    text
}
