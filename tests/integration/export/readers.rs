//! Recordings of maps, read by two readers that know nothing of each other: `mcap-ros2-support`, which reads the
//! definitions of messages in the file, and `rosbags`, which has definitions of its own. They are installed beside the
//! build by the first run.
//!
//! Invariant: without Python or the network a reader is skipped, which the test prints; only the readers' answers are
//! compared.

use std::process::Command;

use serde_json::Value;

use super::{Cells, DAY, Home, known_cells};
use crate::grid::map_file::{python_with, run};

/// The readers' versions, and scripts that print a line of JSON for each map.
const READERS: [(&str, &str); 2] = [("mcap-ros2-support==0.6.0", MCAP_SCRIPT), ("rosbags==0.11.9", ROSBAGS_SCRIPT)];

const MCAP_SCRIPT: &str = r"
import json, sys
from mcap_ros2.reader import read_ros2_messages
for read in read_ros2_messages(sys.argv[1], topics=['/map']):
    grid = read.ros_msg
    at = grid.info.origin.position
    print(json.dumps(dict(log_time=read.log_time_ns, sec=grid.header.stamp.sec, frame=grid.header.frame_id,
        resolution=grid.info.resolution, width=grid.info.width, height=grid.info.height, x=at.x, y=at.y,
        w=grid.info.origin.orientation.w, data=list(grid.data))))
";

const ROSBAGS_SCRIPT: &str = r"
import json, sys
from pathlib import Path
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
with AnyReader([Path(sys.argv[1])], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
    maps = [c for c in reader.connections if c.topic == '/map']
    for connection, log_time, raw in reader.messages(connections=maps):
        grid = reader.deserialize(raw, connection.msgtype)
        at = grid.info.origin.position
        print(json.dumps(dict(log_time=log_time, sec=grid.header.stamp.sec, frame=grid.header.frame_id,
            resolution=float(grid.info.resolution), width=int(grid.info.width), height=int(grid.info.height),
            x=at.x, y=at.y, w=grid.info.origin.orientation.w, data=[int(cell) for cell in grid.data])))
";

#[test]
fn recorded_maps_are_read_by_others_as_they_were_meant() {
    let home = Home::new();
    let all = home.export("all.mcap", &DAY).0;
    let maps = home.export("maps.mcap", &[&DAY[..], &["--content", "map"]].concat()).0;
    let expected: Vec<Cells> =
        ["00", "06", "12", "18"].map(|hour| home.cells(&format!("2025-01-28T{hour}:00:00Z"))).into();
    for (package, script) in READERS {
        let python = match python_with(package) {
            Ok(python) => python,
            Err(reason) => {
                println!("SKIPPED: {package} cannot be installed: {reason}");
                continue;
            }
        };
        // rosbags refuses a file that has other messages than those of ROS, as ros2 bag does.
        let files = if package.starts_with("rosbags") { vec![&maps] } else { vec![&maps, &all] };
        for file in files {
            let text = run(Command::new(&python).args(["-c", script]).arg(file));
            let text = text.unwrap_or_else(|reason| panic!("{package} does not take {}: {reason}", file.display()));
            let grids: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
            assert_eq!(grids.iter().map(cells).collect::<Vec<_>>(), expected, "{package}");
            for (step, grid) in (0..).zip(&grids) {
                let secs = 1_738_022_400_u64 + step * 21_600;
                assert_eq!((&grid["sec"], &grid["log_time"]), (&secs.into(), &(secs * 1_000_000_000).into()));
                assert_eq!((&grid["frame"], &grid["w"]), (&"map".into(), &1.0.into()));
            }
        }
    }
}

fn cells(grid: &Value) -> Cells {
    let percents = grid["data"].as_array().expect("cells").iter().map(|cell| cell.as_i64().expect("a number") as i32);
    let percents: Vec<i32> = percents.collect();
    let number = |name: &str| grid[name].as_f64().expect("a number");
    assert_eq!(percents.len() as f64, number("width") * number("height"));
    known_cells(&percents, number("width") as usize, [number("x"), number("y")], number("resolution"))
}
