//! A recording of a robot with a 3-D scanner in a hall with pillars.
//!
//! Invariant: the points follow from the position of the robot at that time.

use std::{
    f64::consts::{PI, TAU},
    fs::{self, File},
    io::BufWriter,
    path::Path,
};

use tidemap_formats::robot_recording::RobotRecording;

use super::{CloudArgs, START_SECS, SampleFile};

const CLOUDS_A_SECOND: i64 = 10;
const SEC_NANOS: i64 = 1_000_000_000;
/// Rings of the scanner, points of each ring, and the elevation of the highest and lowest ring, radians.
const RINGS: u32 = 64;
const RING_POINTS: u32 = 1_563;
const HIGHEST_RAD: f64 = 0.4;
/// The hall: from corner to corner, metres. The scanner is at half its height.
const HALL_M: [f64; 3] = [40.0, 20.0, 3.0];
/// Distance between two pillars along the hall, and their radius, metres.
const PILLARS_M: f64 = 5.0;
const PILLAR_RADIUS_M: f64 = 0.3;
const SPEED_M_S: f64 = 0.5;

const TRY: &str = r#"#!/bin/sh
# A robot with a 3-D scanner. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# The map, and how long it takes.
time tidemap import hall3d clouds.mcap

# The page: tidemap open hall3d
"#;

pub(super) fn write(folder: &Path, args: &CloudArgs) -> anyhow::Result<Vec<SampleFile>> {
    let mut recording = RobotRecording::new(BufWriter::new(File::create(folder.join("clouds.mcap"))?))?;
    let clouds = i64::from(args.seconds) * CLOUDS_A_SECOND;
    for cloud in 0..=clouds {
        let time = START_SECS * SEC_NANOS + cloud * SEC_NANOS / CLOUDS_A_SECOND;
        let elapsed = cloud as f64 / CLOUDS_A_SECOND as f64;
        // There and back along the middle of the hall.
        let way = HALL_M[0] - 4.0;
        let along = (elapsed * SPEED_M_S).rem_euclid(2.0 * way);
        let x = 2.0 + if along < way { along } else { 2.0 * way - along };
        recording.transform(("/tf", time), ("map", "lidar"), [x, HALL_M[1] / 2.0, HALL_M[2] / 2.0], 0.0)?;
        if cloud < clouds {
            recording.cloud(("/points", time), "lidar", &seen_from(x))?;
        }
    }
    recording.finish()?;
    fs::write(folder.join("try.sh"), TRY)?;
    let rows = u64::try_from(2 * clouds + 1).unwrap_or_default();
    Ok(vec![
        SampleFile { name: "clouds.mcap", rows, what: "point clouds of 100,000 points, ten a second, and transforms" },
        SampleFile { name: "try.sh", rows: TRY.lines().count() as u64, what: "commands to try" },
    ])
}

/// The points that the scanner sees, in its frame.
fn seen_from(x: f64) -> Vec<[f32; 3]> {
    let mut points = Vec::with_capacity((RINGS * RING_POINTS) as usize);
    for ring in 0..RINGS {
        let height = HIGHEST_RAD * (2.0 * f64::from(ring) / f64::from(RINGS - 1) - 1.0);
        for point in 0..RING_POINTS {
            let angle = TAU * f64::from(point) / f64::from(RING_POINTS) - PI;
            let direction = [height.cos() * angle.cos(), height.cos() * angle.sin(), height.sin()];
            let range = range([x, HALL_M[1] / 2.0, HALL_M[2] / 2.0], direction);
            points.push(direction.map(|along| (along * range) as f32));
        }
    }
    points
}

/// The range to the walls, the floor, the ceiling or the next pillar, metres.
fn range(from: [f64; 3], direction: [f64; 3]) -> f64 {
    let mut range = f64::INFINITY;
    for axis in 0..3 {
        let wall = if direction[axis] > 0.0 { HALL_M[axis] } else { 0.0 };
        if direction[axis].abs() > 1e-9 {
            range = range.min((wall - from[axis]) / direction[axis]);
        }
    }
    // Pillars stand in two rows, a quarter of the width from the walls.
    let flat = direction[0].hypot(direction[1]);
    let row = if direction[1] > 0.0 { 0.75 } else { 0.25 } * HALL_M[1];
    let to_row = (row - from[1]) / direction[1];
    if direction[1].abs() > 1e-9 && to_row < range {
        let pillar = ((from[0] + to_row * direction[0]) / PILLARS_M).round() * PILLARS_M;
        // The nearest point of the ray to the axis of the pillar, seen from above.
        let to = [pillar - from[0], row - from[1]];
        let near = (to[0] * direction[0] + to[1] * direction[1]) / (flat * flat);
        let miss = (near * direction[0] - to[0]).hypot(near * direction[1] - to[1]);
        if miss < PILLAR_RADIUS_M {
            range = range.min(near - (PILLAR_RADIUS_M.powi(2) - miss * miss).sqrt() / flat);
        }
    }
    range
}
