//! Files for a grid on the command line: a valid OctoMap, one that is cut off, and files that do not fit.

use std::{fs, path::Path};

use tidemap_client::{
    maps::{GridSpec, Retention},
    queries::ModelKind,
};
use tidemap_tests::{
    cli::{self, Outcome},
    daemon::Daemon,
};

use super::{grid, model, office, predicted, summary};

const AT: &str = "2025-03-03T12:00:00Z";
/// Some time after that.
const LATER: &str = "2025-03-03T12:05:00Z";

/// A tree of 18 nodes: cell (0, 0, 0) is occupied, cell (1, 0, 0) is free.
fn octomap(resolution_m: f64) -> Vec<u8> {
    let header = format!("# Octomap OcTree binary file\nid OcTree\nsize 18\nres {resolution_m}\ndata\n");
    let mut nodes = vec![3_u16 << 14];
    nodes.extend([3; 14]);
    nodes.push(2 | 1 << 2);
    header.into_bytes().into_iter().chain(nodes.into_iter().flat_map(u16::to_le_bytes)).collect()
}

fn observe(daemon: &Daemon, file: &Path, more: &[&str]) -> Outcome {
    let file = file.to_str().expect("a path of text");
    let words = ["grid", "observe", super::MAP, file, "--producer", "robot"];
    cli::tidemap(daemon, words.iter().chain(more))
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_files_that_are_cut_off_or_do_not_fit_are_refused_and_harm_nothing() {
    let (data, daemon) = office(grid(Retention::None)).await;
    let file = |name: &str, bytes: &[u8]| {
        let path = data.path().join(name);
        fs::write(&path, bytes).expect("a file");
        path
    };
    let whole = octomap(0.1);
    for length in [whole.len() - 1, whole.len() - 7, whole.len() - 32, 70, 20, 0] {
        let cut = file("cut.bt", &whole[..length]);
        observe(&daemon, &cut, &["--at", AT]).fails(1, &["cut.bt"]);
    }
    // The message contains the offset where a tree is cut off within a node.
    let at = (whole.len() - 2).to_string();
    observe(&daemon, &file("cut.bt", &whole[..whole.len() - 1]), &["--at", AT]).fails(1, &["cut.bt", &at]);
    let longer = [&whole[..], &[0, 0]].concat();
    observe(&daemon, &file("long.bt", &longer), &["--at", AT]).fails(1, &["long.bt", "2"]);
    observe(&daemon, &file("coarse.bt", &octomap(0.25)), &["--at", AT]).fails(1, &["coarse.bt", "0.25", "0.1"]);
    observe(&daemon, &file("no.pcd", b"hello"), &["--at", AT, "--pose", "0,0,0,0,0,0,1"]).fails(1, &["no.pcd"]);
    observe(&daemon, &file("no.tms", b"tidemap scans 9\n"), &[]).fails(1, &["no.tms"]);
    observe(&daemon, &file("some.txt", b""), &["--at", AT]).fails(2, &["some.txt", ".bt"]);
    observe(&daemon, &data.path().join("absent.bt"), &["--at", AT]).fails(1, &["absent.bt"]);
    let good = file("good.bt", &whole);
    observe(&daemon, &good, &[]).fails(2, &["--at"]);
    assert_eq!(summary(&daemon).await.scans, 0, "nothing was sent");

    let sent = observe(&daemon, &good, &["--at", AT]).table();
    assert_eq!((sent.number("scans"), sent.number("cells"), sent.number("refused")), (1.0, 2.0, 0.0));
    let again = observe(&daemon, &good, &["--at", AT]).table();
    assert_eq!((again.number("scans"), again.number("duplicate")), (0.0, 1.0));
    let latest = predicted(&daemon, 1_741_000_000_000_000_000, model(ModelKind::Latest, None)).await;
    let cells = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [-1, 0, 0]].map(|cell| latest.cell(cell).value());
    assert_eq!(cells, [Some(1.0), Some(0.0), None, None]);
    assert_eq!((summary(&daemon).await.scans, summary(&daemon).await.cell_observations), (1, 2));

    let weak = |sensor: &str, code: i32, words: &[&str]| {
        observe(&daemon, &good, &["--at", LATER, "--label", "weak", "--sensor", sensor]).fails(code, words);
    };
    weak("hit=0.2,false-alarm=0.8", 2, &["--sensor", "hit has to be above false-alarm"]);
    let words = ["--at", LATER, "--label", "weak", "--sensor", "hit=0.8,false-alarm=0.2"];
    assert_eq!(observe(&daemon, &good, &words).table().number("scans"), 1.0);
    let latest = predicted(&daemon, 1_741_000_000_000_000_000, model(ModelKind::Latest, None)).await;
    for (cell, expected) in [([0, 0, 0], 0.8), ([1, 0, 0], 0.2)] {
        let value = latest.cell(cell).value().expect("a known cell");
        assert!((value - expected).abs() < 1e-6, "{cell:?}: {value}");
    }
    weak("hit=0.7", 1, &["hit 0.8, false alarm 0.2", "hit 0.7, false alarm 0", "another label"]);
    assert_eq!(summary(&daemon).await.scans, 2, "what was refused sent nothing");
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn grids_that_cannot_be_are_not_created() {
    use tidemap_client::maps::{CellBox, NewMap, SensorNoise};
    let (_data, daemon) = office(grid(Retention::None)).await;
    let extent = |min: [i32; 3], max: [i32; 3]| Some(CellBox { min: min.into(), max: max.into() });
    let noise = |hit: f64, false_alarm: f64, prior: f64| SensorNoise { hit, false_alarm, prior };
    let fine = || grid(Retention::None);
    for (grid, words) in [
        (GridSpec { resolution_m: 0.0, ..fine() }, ["resolution", "0 m"]),
        (GridSpec { resolution_m: f64::NAN, ..fine() }, ["resolution", "NaN"]),
        (GridSpec { resolution_m: -0.1, ..fine() }, ["resolution", "-0.1"]),
        (GridSpec { resolution_m: 1001.0, ..fine() }, ["resolution", "1001"]),
        (GridSpec { origin_m: [0.0, f64::INFINITY, 0.0], ..fine() }, ["origin", "inf"]),
        (GridSpec { origin_m: [0.0, 0.0, 1e9], ..fine() }, ["origin", "1000000000"]),
        (GridSpec { frame_id: "f".repeat(129), ..fine() }, ["frame", "fff"]),
        (GridSpec { frame_id: "a\nb".to_owned(), ..fine() }, ["frame", "a\\nb"]),
        (GridSpec { extent: extent([0; 3], [0, 5, 5]), ..fine() }, ["extent", "0x5x5"]),
        (GridSpec { extent: extent([5; 3], [2; 3]), ..fine() }, ["extent", "0x0x0"]),
        (GridSpec { extent: extent([0; 3], [i32::MAX, 1, 1]), ..fine() }, ["extent", "2147483647"]),
        (GridSpec { is_flat: true, extent: extent([0; 3], [9; 3]), ..fine() }, ["extent", "z = 0"]),
        (GridSpec { sensor: noise(0.3, 0.4, 0.5), ..fine() }, ["hit 0.3", "false alarm 0.4"]),
        (GridSpec { sensor: noise(0.9, 0.1, 1.0), ..fine() }, ["sensor", "prior 1"]),
        (GridSpec { sensor: noise(f64::NAN, 0.1, 0.5), ..fine() }, ["sensor", "NaN"]),
        (GridSpec { retention: Retention::Duration(0), ..fine() }, ["retention", "0"]),
        (GridSpec { retention: Retention::Duration(-5), ..fine() }, ["retention", "-5"]),
    ] {
        let map = NewMap { name: "lab".to_owned(), grid: Some(grid.clone()), ..NewMap::default() };
        let refused = daemon.client().create_map(map).await.expect_err("refused").to_string();
        for word in words {
            assert!(refused.contains(word), "{word:?} is not in {refused:?} of {grid:?}");
        }
    }
    let names: Vec<String> = daemon.client().maps().await.expect("maps").into_iter().map(|map| map.name).collect();
    assert_eq!(names, [super::MAP]);
}
