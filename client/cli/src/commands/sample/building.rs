//! A building: maps of its floor by the hour, its rooms and front door, its topological map, and a robot's traversals.
//!
//! Invariant: all files are about the same two weeks of the same building.

use std::{fmt::Write as _, fs, path::Path};

use jiff::{ToSpan as _, civil::date};
use tidemap_sim::{BuildingDay, FloorPlan, building_places, building_ways};

use super::{BuildingArgs, DAY_SECS, SEED, SampleFile};

/// Monday, 3 March 2025, midnight in London and UTC.
const START_SECS: i64 = 1_740_960_000;

const TRY: &str = r#"#!/bin/sh
# Two weeks of a building. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# A map with a flat grid, and a Nav2 map for every hour: the times are in the names of the files.
tidemap map create building --time-zone Europe/London --grid resolution=CELL,flat
tidemap grid observe building maps --times-from 'map_%Y-%m-%d_%H-%M.yaml' --utc --producer scanner --label maps

# The rooms and the front door, the topological map, and the traversals of a robot.
tidemap observe building rooms.csv --producer robot-1
tidemap topology load building topology.yaml
tidemap traverse building drives.csv --producer robot-1

# Learn now instead of at midnight.
tidemap update building

# A Tuesday at ten: the floor, the rooms, and the way to the kitchen.
tidemap grid predict building --at 2025-03-18T10:00:00Z --picture ten.png
tidemap predict building 'office-?' lab kitchen meeting-room storage front-door --date 2025-03-18 --picture
tidemap route building entrance kitchen --at 2025-03-18T10:00:00Z

# The page shows all of it. Here is its address for that Tuesday; without --print it opens.
tidemap open building --at 2025-03-18T10:00:00Z --print
"#;

pub(super) fn write(folder: &Path, args: &BuildingArgs) -> anyhow::Result<Vec<SampleFile>> {
    let maps = folder.join("maps");
    fs::create_dir(&maps)?;
    let (mut rooms, mut drives) = ("time,state,value\n".to_owned(), "from,to,start,end,success,reason\n".to_owned());
    let (mut readings, mut driven) = (0_u64, 0_u64);
    let every = DAY_SECS / i64::from(args.scans_per_day);
    for number in 0..args.days {
        let date = date(2025, 3, 3).saturating_add(i64::from(number).days());
        let (day, midnight) = (BuildingDay::new(SEED, date), START_SECS + i64::from(number) * DAY_SECS);
        for reading in day.readings() {
            writeln!(rooms, "{},{},{}", midnight + reading.secs, reading.state, u8::from(reading.is_on))?;
            readings += 1;
        }
        for drive in day.drives() {
            let (start, end) = (midnight + drive.start_secs, midnight + drive.end_secs);
            let reason = if drive.success { "" } else { "door closed" };
            writeln!(drives, "{},{},{start},{end},{},{reason}", drive.from, drive.to, drive.success)?;
            driven += 1;
        }
        for scan in 0..i64::from(args.scans_per_day) {
            let secs = scan * every;
            let name = format!("map_{date}_{:02}-{:02}", secs / 3_600, secs % 3_600 / 60);
            fs::write(maps.join(format!("{name}.pgm")), image(&day.floor(secs, args.cell)))?;
            fs::write(maps.join(format!("{name}.yaml")), description(&name, args.cell))?;
        }
    }
    let places = topology();
    fs::write(folder.join("rooms.csv"), rooms)?;
    fs::write(folder.join("drives.csv"), drives)?;
    fs::write(folder.join("topology.yaml"), &places)?;
    fs::write(folder.join("try.sh"), TRY.replace("CELL", &args.cell.to_string()))?;
    let scans = u64::from(args.days) * u64::from(args.scans_per_day);
    let lines = |text: &str| text.lines().count() as u64;
    Ok(vec![
        SampleFile { name: "maps", rows: scans, what: "Nav2 maps, .yaml and .pgm" },
        SampleFile { name: "rooms.csv", rows: readings, what: "rooms in use, and the front door" },
        SampleFile { name: "drives.csv", rows: driven, what: "traversals of a robot" },
        SampleFile { name: "topology.yaml", rows: lines(&places), what: "the topological map, as ROS writes it" },
        SampleFile { name: "try.sh", rows: lines(TRY), what: "commands to try" },
    ])
}

/// A plan as Nav2 stores it: 0 occupied, 254 free.
fn image(plan: &FloorPlan) -> Vec<u8> {
    let mut bytes = format!("P5\n{} {}\n255\n", plan.width, plan.height).into_bytes();
    bytes.extend(plan.occupied.iter().map(|&is_occupied| if is_occupied { 0 } else { 254 }));
    bytes
}

fn description(name: &str, cell_m: f64) -> String {
    format!(
        "image: {name}.pgm\nresolution: {cell_m}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n\
         free_thresh: 0.196\n"
    )
}

fn topology() -> String {
    let mut text = String::new();
    for place in building_places() {
        let (name, x_m, y_m) = (place.name, place.x_m, place.y_m);
        let _ = writeln!(
            text,
            "- node:\n    name: {name}\n    pose: {{position: {{x: {x_m:.2}, y: {y_m:.2}, z: 0.0}}}}\n    edges:"
        );
        let both = building_ways().iter().flat_map(|&(from, to)| [(from, to), (to, from)]);
        for (_, to) in both.filter(|(from, _)| *from == name) {
            let _ = writeln!(text, "    - {{node: {to}}}");
        }
    }
    text
}
