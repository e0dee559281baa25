//! The simulated office: the observations and the drives of three robots, and the week after, for comparison with
//! predictions.
//!
//! Invariant: a traversal fails if the door on its edge is shut, and now and then because something stands in the way.

use std::{fmt::Write as _, fs, path::Path};

use tidemap_sim::Office;

use super::{DAY_SECS, SEC, SEED, START_SECS, SampleFile, ZONE, observed};

/// Days that the robots observe.
const DAYS: i64 = 42;
/// Nodes with their positions, metres.
const NODES: [(&str, f64, f64); 10] = [
    ("entrance", 0.0, 0.0),
    ("corridor", 8.0, 0.0),
    ("office-1", 4.0, 5.0),
    ("office-2", 8.0, 5.0),
    ("office-3", 12.0, 5.0),
    ("meeting-room", 4.0, -5.0),
    ("kitchen", 9.0, -5.0),
    ("lab", 16.0, 0.0),
    ("storage", 15.0, -6.0),
    ("back-door", -4.0, -10.0),
];
/// Edges in both directions, each with the state of its door.
const EDGES: [(&str, &str, Option<&str>); 10] = [
    ("entrance", "corridor", Some("entrance-door")),
    ("corridor", "office-1", Some("office-1-door")),
    ("corridor", "office-2", Some("office-2-door")),
    ("corridor", "office-3", Some("office-3-door")),
    ("corridor", "meeting-room", None),
    ("corridor", "kitchen", None),
    ("corridor", "lab", Some("lab-door")),
    ("kitchen", "storage", Some("storage-door")),
    ("entrance", "back-door", None),
    ("back-door", "kitchen", None),
];
const SPEED_M_PER_S: f64 = 0.5;

const TRY: &str = r#"#!/bin/sh
# Six weeks of an office. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# A map, the topological map, the observations of three robots, and their traversals.
tidemap map create office --time-zone Europe/London
tidemap topology load office topology.yaml
for robot in robot-ada robot-bob robot-cleo; do tidemap observe office $robot.csv --producer $robot; done
tidemap traverse office traversals.csv --producer robot-ada

# Learn now instead of at midnight, and predict the Tuesday after.
tidemap update office
tidemap predict office kitchen meeting-room --from 2025-02-18T08:00:00Z --to 2025-02-18T18:00:00Z --step 2h

# How good is that? Compare with the week that really came.
tidemap evaluate office next-week.csv --models auto,mean,latest

# The way to the kitchen: by day through the entrance, at night around the house. And a search for somebody.
tidemap route office entrance kitchen --objective time --at 2025-02-18T12:00:00Z
tidemap route office entrance kitchen --objective time --at 2025-02-18T23:00:00Z
tidemap search office --start corridor --at 2025-02-18T10:30:00Z

# Where an observation is worth most now.
tidemap info office --at 2025-02-18T10:30:00Z --state kitchen --state meeting-room --state storage-door

# The page: tidemap open office
"#;

/// The topological map as ROS writes it.
fn topology() -> String {
    let mut text = String::new();
    for (name, x, y) in NODES {
        let _ = writeln!(
            text,
            "- node:\n    name: {name}\n    pose: {{position: {{x: {x:.1}, y: {y:.1}, z: 0.0}}}}\n    edges:"
        );
        for (from, to, _) in EDGES {
            for to in [(from, to), (to, from)].into_iter().filter(|(from, _)| *from == name).map(|(_, to)| to) {
                let _ = writeln!(text, "    - {{node: {to}}}");
            }
        }
    }
    text
}

fn length_m(from: &str, to: &str) -> f64 {
    let place = |name: &str| NODES.iter().find(|node| node.0 == name).map_or((0.0, 0.0), |node| (node.1, node.2));
    let ((x1, y1), (x2, y2)) = (place(from), place(to));
    (x2 - x1).hypot(y2 - y1)
}

/// A traversal of each edge each hour, in turn in both directions.
fn traversals(office: &Office) -> (String, u64) {
    let (mut text, mut rows) = ("from,to,start,end,success,reason\n".to_owned(), 0_u64);
    for hour in 0..DAYS * 24 {
        for (number, (from, to, door)) in (0_i64..).zip(EDGES) {
            let start = START_SECS + hour * 3_600 + number * 300 + (hour * 37 + number * 11) % 200;
            let state = door.and_then(|door| office.states().iter().position(|&state| state == door));
            let is_shut = state.is_some_and(|state| office.truth(state, start * SEC) < 0.5);
            let is_blocked = rows % 53 == 17;
            let (success, reason) = match (is_shut, is_blocked) {
                (true, _) => (false, "door shut"),
                (_, true) => (false, "something in the way"),
                _ => (true, ""),
            };
            let (from, to) = if hour % 2 == 0 { (from, to) } else { (to, from) };
            // Around noon there are people in the way.
            let slow = if (11..14).contains(&(hour % 24)) { 1.4 } else { 1.0 + (rows % 7) as f64 / 50.0 };
            let end = start as f64 + length_m(from, to) / SPEED_M_PER_S * slow;
            let _ = writeln!(text, "{from},{to},{start},{end:.1},{success},{reason}");
            rows += 1;
        }
    }
    (text, rows)
}

/// Every state every 20 minutes of the week after.
fn next_week(office: &Office) -> (String, u64) {
    let (mut text, mut rows) = ("time,state,value\n".to_owned(), 0);
    let start = START_SECS + DAYS * DAY_SECS;
    for time in (start..start + 7 * DAY_SECS).step_by(1_200) {
        for (state, name) in office.states().iter().enumerate() {
            let _ = writeln!(text, "{time},{name},{}", office.truth(state, time * SEC));
            rows += 1;
        }
    }
    (text, rows)
}

pub(super) fn write(folder: &Path) -> anyhow::Result<Vec<SampleFile>> {
    let office = Office::new(SEED, ZONE)?;
    let mut files = Vec::new();
    let mut put = |name: &'static str, (text, rows): (String, u64), what| {
        files.push(SampleFile { name, rows, what });
        fs::write(folder.join(name), text)
    };
    for (robot, name) in ["robot-ada.csv", "robot-bob.csv", "robot-cleo.csv"].into_iter().enumerate() {
        put(name, observed(&office, robot, DAYS, |_| true), "its observations: open doors, rooms with people")?;
    }
    put("topology.yaml", (topology(), NODES.len() as u64), "nodes with positions, and edges")?;
    put("traversals.csv", traversals(&office), "drives along the edges; some doors were shut")?;
    put("next-week.csv", next_week(&office), "the week after, to compare with")?;
    put("try.sh", (TRY.to_owned(), TRY.lines().count() as u64), "commands to try")?;
    Ok(files)
}
