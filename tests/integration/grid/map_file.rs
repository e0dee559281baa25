//! A map written as PGM and YAML, read by an independent reader, cell by cell: `pyrobosim` of the Python package
//! index, installed beside the build by the first run, which takes about a minute.
//!
//! Invariant: without Python or the network the test is skipped and prints so; only the reader's own answers are
//! compared.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use tidemap_client::time::format_rfc3339;
use tidemap_client::{
    maps::Retention,
    observe::tiles::{Mask, TileIndex, TileMasks},
    queries::{GridQuery, ModelKind},
};
use tidemap_tests::{cli, film::Film, oracle::run_update};

use super::{MAP, grid, model, office, partial_view, producer, send};

/// The reader's version; a later one may read differently.
const READER: &str = "pyrobosim==5.0.1";

/// Prints what the reader sees: resolution, origin, width and height, then a line per row from the bottom.
const SCRIPT: &str = r"
from pyrobosim.navigation.occupancy_grid import OccupancyGrid
import sys
grid = OccupancyGrid.from_file('.', sys.argv[1])
print(grid.resolution, grid.origin[0], grid.origin[1], grid.width, grid.height)
for y in range(grid.height):
    print(''.join({1.0: '#', 0.0: '.'}.get(float(grid.data[x, y]), '?') for x in range(grid.width)))
";

pub(crate) fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let printed = String::from_utf8_lossy(&output.stderr);
    Err(format!("{}: {}", command.get_program().display(), printed.trim().lines().last().unwrap_or_default()))
}

/// Python with a package, or the reason why it is missing.
pub(crate) fn python_with(package: &str) -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (ready, unfinished) = (folder.join(package), folder.join(format!("{package}.{}", std::process::id())));
    let python = ready.join("bin/python");
    if python.is_file() {
        return Ok(python);
    }
    let installed = run(Command::new("python3").args(["-m", "venv"]).arg(&unfinished)).and_then(|_| {
        let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", package];
        run(Command::new(unfinished.join("bin/python")).args(pip))
    });
    if let Err(reason) = installed {
        let _ = fs::remove_dir_all(&unfinished);
        return Err(reason);
    }
    // The environment gets its name only when it is complete. Another run may have been faster.
    if fs::rename(&unfinished, &ready).is_err() {
        let _ = fs::remove_dir_all(&unfinished);
    }
    Ok(python)
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_written_as_pgm_is_read_by_others_as_it_was_meant() {
    let python = match python_with(READER) {
        Ok(python) => python,
        Err(reason) => return println!("SKIPPED: {READER} cannot be installed: {reason}"),
    };
    let film = Film::new(2, 300);
    let (data, daemon) = office(grid(Retention::None)).await;
    // A partial view that leaves some columns of each tile out, so that these stay unknown.
    let mut robot = producer(&daemon, "robot").await;
    let hidden = |(time, mut tiles): (i64, Vec<(TileIndex, TileMasks)>)| {
        let left_out = Mask([0xF0F0_0000_0000_0081; 8]);
        for (_, masks) in &mut tiles {
            *masks = TileMasks::clipped(masks.observed().without(left_out), masks.occupied());
        }
        (time, tiles)
    };
    send(&mut robot, partial_view(&film).map(hidden)).await;
    let client = daemon.client();
    run_update(&client, MAP, None).await;

    let at = film.time(film.scans() - 50) + 1_234_567_890;
    let query = GridQuery {
        map: MAP.to_owned(),
        time_nanos: at,
        model: model(ModelKind::Mean, None),
        is_projected: true,
        ..GridQuery::default()
    };
    let expected = client.predict_grid(&query).await.expect("a grid").whole().await.expect("all of it");
    let out = data.path().join("office.pgm");
    let out = out.to_str().expect("a path of text");
    let words = ["grid", "predict", MAP, "--at", &format_rfc3339(at), "--model", "mean", "--out", out];
    cli::tidemap(&daemon, words).table();

    let printed = run(Command::new(python).current_dir(data.path()).args(["-c", SCRIPT, "office"]));
    let printed = printed.unwrap_or_else(|reason| panic!("the reader does not take the files: {reason}"));
    let mut lines = printed.lines();
    let numbers = lines.next().expect("a first line").split(' ').map(|n| n.parse().expect("a number"));
    let numbers: Vec<f64> = numbers.collect();
    let region = expected.header.region;
    let [width, height, layers] = region.size();
    assert_eq!(layers, 1);
    let corner = [region.min.x, region.min.y].map(|least| f64::from(least) * 0.1);
    for (found, expected) in numbers.iter().zip([0.1, corner[0], corner[1], width as f64, height as f64]) {
        assert!((found - expected).abs() < 1e-9, "{numbers:?}");
    }
    let rows: Vec<&str> = lines.collect();
    assert_eq!(rows.len(), height as usize);
    let mut seen = [0; 4];
    for (y, row) in (region.min.y..).zip(&rows) {
        assert_eq!(row.len(), width as usize);
        for (x, found) in (region.min.x..).zip(row.chars()) {
            let cell = expected.cell([x, y, 0]).value().map(|value| (f64::from(value) * 100.0).round());
            let (kind, meant) = match cell {
                Some(percent) if percent <= 25.0 => (0, '.'),
                Some(percent) if percent >= 65.0 => (1, '#'),
                Some(_) => (2, '?'),
                None => (3, '?'),
            };
            assert_eq!(found, meant, "cell {x}, {y} with {cell:?} per cent");
            seen[kind] += 1;
        }
    }
    println!("free, occupied, unsure, unknown: {seen:?}");
    assert!(seen[0] > 40 && seen[1] > 40 && seen[3] > 40, "there is something to compare: {seen:?}");
}
