//! A map written as an OctoMap, read by OctoMap itself, cell by cell: `pyoctomap` of the Python package index,
//! installed beside the build by the first run.
//!
//! Invariant: without Python or the network the test is skipped and prints so; only OctoMap's own answers are compared.

use std::{collections::BTreeMap, process::Command};

use tidemap_client::{maps::Retention, queries::ModelKind, time::format_rfc3339};
use tidemap_tests::{cli, film::Film, oracle::run_update};

use super::{
    MAP, grid,
    map_file::{python_with, run},
    model, office, partial_view, predicted, producer, send,
};

/// OctoMap's version.
const OCTOMAP: &str = "pyoctomap==1.2.2";

/// Prints resolution and number of nodes, then of every leaf its lowest cell, its cells along a side, and whether it is
/// occupied.
const SCRIPT: &str = r"
import pyoctomap, sys
tree = pyoctomap.OcTree(1.0)
assert tree.readBinary(sys.argv[1])
side = tree.getResolution()
print(side, tree.size())
for leaf in tree.begin_leafs():
    centre, size = leaf.getCoordinate(), leaf.getSize()
    low = [round((at - size / 2) / side) for at in centre]
    print(*low, round(size / side), int(tree.isNodeOccupied(leaf.current_node)))
";

#[tokio::test(flavor = "multi_thread")]
async fn grid_written_as_octomap_is_read_by_octomap_as_it_was_meant() {
    let python = match python_with(OCTOMAP) {
        Ok(python) => python,
        Err(reason) => return println!("SKIPPED: {OCTOMAP} cannot be installed: {reason}"),
    };
    let film = Film::new(2, 300);
    let (data, daemon) = office(grid(Retention::None)).await;
    let mut robot = producer(&daemon, "robot").await;
    send(&mut robot, partial_view(&film)).await;
    run_update(&daemon.client(), MAP, None).await;
    let at = film.time(film.scans() - 50) + 1_234_567_890;
    let whole = predicted(&daemon, at, model(ModelKind::Mean, None)).await;
    let time = format_rfc3339(at);
    for (threshold, options) in [(0.5, &[][..]), (0.9, &["--threshold", "0.9"])] {
        let out = data.path().join("office.bt");
        let out = out.to_str().expect("a path of text");
        let words = ["grid", "predict", MAP, "--at", &time, "--model", "mean", "--out", out];
        cli::tidemap(&daemon, words.iter().chain(options)).table();
        let printed = run(Command::new(&python).current_dir(data.path()).args(["-c", SCRIPT, "office.bt"]));
        let printed = printed.unwrap_or_else(|reason| panic!("OctoMap does not take the file: {reason}"));
        let mut lines = printed.lines().map(|line| line.split(' ').map(|n| n.parse::<f64>().expect("a number")));
        let resolution = lines.next().and_then(|mut numbers| numbers.next());
        assert_eq!(resolution, Some(0.1));

        let mut found = BTreeMap::new();
        for line in lines {
            let numbers: Vec<i32> = line.map(|number| number as i32).collect();
            let [x, y, z, side, occupied] = numbers[..] else { panic!("{numbers:?}") };
            for cell in 0..side * side * side {
                let at = [x + cell % side, y + cell / side % side, z + cell / side / side];
                assert_eq!(found.insert(at, occupied == 1), None, "{at:?} is in two leaves");
            }
        }
        let mut expected = BTreeMap::new();
        for tile in &whole.tiles {
            for (place, cell) in (0_i32..).zip(tile.cells.iter()) {
                let within = [place % 8, place / 8 % 8, place / 64];
                let index = std::array::from_fn(|axis| tile.place[axis] * 8 + within[axis]);
                expected.extend(cell.value().map(|value| (index, f64::from(value) >= threshold)));
            }
        }
        let occupied = expected.values().filter(|&&occupied| occupied).count();
        println!("from {threshold}: {occupied} of {} cells are occupied", expected.len());
        assert!(occupied > 40 && occupied + 40 < expected.len(), "there is something to compare");
        assert!(found == expected, "{} cells were read", found.len());
    }
    let words = ["grid", "predict", MAP, "--at", &time, "--entropy", "--out", "no.bt"];
    cli::tidemap(&daemon, words).fails(2, &["--entropy", ".bt"]);
}
