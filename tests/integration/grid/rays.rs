//! Point clouds and planar range scans, ray-cast by the daemon: cells on a ray are free, its end is occupied, and
//! cells beyond stay unknown.

use std::f64::consts::FRAC_1_SQRT_2;

use tidemap_client::{
    Client, Error,
    maps::{CellBox, GridSpec},
    observe::{
        Producer, RefusalReason,
        scan::{Isometry3, PointCloud, Quaternion, RangeScan, Scan, Translation3, UnitQuaternion},
    },
    queries::{CellPrediction, GridQuery, ModelKind, WholeGrid},
};
use tidemap_tests::oracle::run_update;
use tonic::Code;

use super::{MAP, model, office, predicted, producer, summary};

const NOON_NANOS: i64 = 1_741_000_000_000_000_000;
const MINUTE_NANOS: i64 = 60_000_000_000;

/// Cells of half a metre.
fn coarse() -> GridSpec {
    GridSpec::new(0.5)
}

/// In the middle of cell (0, 0, 0), turned to the left: the sensor's x axis is the map's y axis.
fn turned() -> Isometry3<f64> {
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2));
    Isometry3::from_parts(Translation3::new(0.25, 0.25, 0.25), rotation)
}

fn cloud(xyz_m: &[f32]) -> Scan {
    Scan::Cloud(PointCloud { pose: turned(), xyz_m: xyz_m.to_vec(), max_range_m: 5.0, ..PointCloud::default() })
}

/// In the middle of cell (200, 0, 0), unturned: front, left, back, right.
fn ranges(ranges_m: &[f32]) -> Scan {
    Scan::Ranges(RangeScan {
        pose: Isometry3::translation(100.25, 0.25, 0.25),
        angle_increment_rad: std::f32::consts::FRAC_PI_2,
        ranges_m: ranges_m.to_vec(),
        max_range_m: 4.0,
        ..RangeScan::default()
    })
}

async fn sent(producer: &mut Producer, time_nanos: i64, scan: Scan) {
    producer.send_scan(time_nanos, scan).await.expect("taken");
    producer.flush().await.expect("durable");
    assert_eq!(producer.take_refusals(), []);
}

/// The states of the cells along a line: '.' free, '#' occupied, '?' unknown, '~' changing.
fn line(grid: &WholeGrid, from: [i32; 3], axis: usize, step: i32, cells: usize) -> String {
    let mut at = from;
    let mut text = String::new();
    for _ in 0..cells {
        text.push(match grid.cell(at) {
            CellPrediction::Unknown => '?',
            CellPrediction::Static(0.0) => '.',
            CellPrediction::Static(1.0) => '#',
            CellPrediction::Changing(_) => '~',
            CellPrediction::Static(other) => panic!("{at:?} is {other}"),
        });
        at[axis] += step;
    }
    text
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_of_rays_distinguishes_free_occupied_and_unknown() {
    let (_data, daemon) = office(coarse()).await;
    let mut robot = producer(&daemon, "robot").await;
    // Three metres to the front; ten up, of which the range limit leaves five; and points that are not numbers.
    sent(&mut robot, NOON_NANOS, cloud(&[3.0, 0.0, 0.0, 0.0, 0.0, 10.0, f32::NAN, 1.0, 1.0])).await;
    sent(&mut robot, NOON_NANOS + 1, ranges(&[2.0, f32::INFINITY, f32::NAN, 1.0])).await;
    let client = daemon.client();
    for update in [false, true] {
        let kind = if update { ModelKind::Auto } else { ModelKind::Latest };
        if update {
            run_update(&client, MAP, None).await;
        }
        let grid = predicted(&daemon, NOON_NANOS, model(kind, None)).await;
        assert_eq!(line(&grid, [0, 0, 0], 1, 1, 10), "......#???", "ahead");
        assert_eq!(line(&grid, [0, 0, 0], 2, 1, 10), "..........", "up, as far as is believed");
        assert_eq!(line(&grid, [0, 0, 11], 2, 1, 12), "????????????", "up, beyond");
        assert_eq!(line(&grid, [0, -1, 0], 1, -1, 9), "?????????", "behind");
        assert_eq!(line(&grid, [1, 0, 0], 0, 1, 9), "?????????", "beside");
        assert_eq!(line(&grid, [200, 0, 0], 0, 1, 8), "....#???", "a reading ahead");
        assert_eq!(line(&grid, [200, 0, 0], 1, 1, 8), ".???????", "no return from the left");
        assert_eq!(line(&grid, [199, 0, 0], 0, -1, 8), "????????", "no reading behind");
        assert_eq!(line(&grid, [200, -1, 0], 1, -1, 4), ".#??", "a reading to the right");
    }
    // On another day the wall is a metre farther: its old cells have changed.
    sent(&mut robot, NOON_NANOS + MINUTE_NANOS, cloud(&[4.0, 0.0, 0.0])).await;
    run_update(&client, MAP, None).await;
    let grid = predicted(&daemon, NOON_NANOS, model(ModelKind::Auto, None)).await;
    assert_eq!(line(&grid, [0, 0, 0], 1, 1, 10), "......~.#?");
    assert_eq!(grid.cell([0, 6, 0]), CellPrediction::Changing(0.5));
    assert_eq!(summary(&daemon).await.scans, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_regions_are_cut_to_the_cells_that_there_are() {
    let (_data, daemon) = office(coarse()).await;
    let mut robot = producer(&daemon, "robot").await;
    sent(&mut robot, NOON_NANOS, cloud(&[3.0, 0.0, 0.0])).await;
    let client = daemon.client();
    let whole = predicted(&daemon, NOON_NANOS, model(ModelKind::Latest, None)).await;
    let ask = |min: [i32; 3], max: [i32; 3]| {
        let region = Some(CellBox { min: min.into(), max: max.into() });
        GridQuery { region, model: model(ModelKind::Latest, None), ..question(MAP) }
    };
    // 10^12 cells, and as many as there can be.
    for (min, max) in [([-5_000; 3], [5_000; 3]), ([i32::MIN; 3], [i32::MAX; 3])] {
        for is_projected in [false, true] {
            let query = GridQuery { is_projected, ..ask(min, max) };
            let found = client.predict_grid(&query).await.expect("an answer").whole().await.expect("all of it");
            let of_whole = if is_projected { found.header.region } else { whole.header.region };
            assert_eq!(found.header.region, of_whole);
            assert!(found.header.cells <= 1024, "{:?}", found.header);
            assert_eq!(found.cell([0, 6, 0]).value(), Some(1.0));
            assert_eq!(found.cell([0, 5, 0]).value(), Some(0.0));
        }
    }
    let one = client.predict_grid(&ask([0, 6, 0], [1, 7, 1])).await.expect("an answer").whole().await.expect("it");
    assert_eq!(one.header.region.count(), 1);
    assert_eq!((one.cell([0, 6, 0]).value(), one.cell([0, 5, 0]).value()), (Some(1.0), None));
    let none = client.predict_grid(&ask([900; 3], [990; 3])).await.expect("an answer").whole().await.expect("it");
    assert_eq!((none.header.region.count(), none.tiles.len()), (0, 0));
    // An empty region gives an empty answer or an error, never the whole grid.
    if let Ok(empty) = client.predict_grid(&ask([5, 0, 0], [2, 9, 9])).await {
        assert_eq!(empty.whole().await.expect("an answer").tiles, []);
    }
}

fn question(map: &str) -> GridQuery {
    GridQuery { map: map.to_owned(), time_nanos: NOON_NANOS, ..GridQuery::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_questions_that_make_no_sense_are_refused_by_name() {
    use tidemap_client::{maps::NewMap, queries::GridOutput};
    let data = tempfile::tempdir().expect("a folder");
    let daemon = tidemap_tests::daemon::Launch::on(data.path()).setting("max_predictions", 9).start();
    let client = daemon.client();
    for (name, grid) in [(MAP, Some(coarse())), ("bare", None)] {
        let map = NewMap { name: name.to_owned(), grid, ..NewMap::default() };
        client.create_map(map).await.expect("a new map");
    }
    let mut robot = producer(&daemon, "robot").await;
    sent(&mut robot, NOON_NANOS, cloud(&[4.5, 0.0, 0.0])).await;
    let with = |output| GridQuery { output, ..question(MAP) };
    for (query, code, words) in [
        (question("attic"), Code::NotFound, ["attic", "bare"]),
        (question("bare"), Code::FailedPrecondition, ["bare", "when it is created"]),
        (GridQuery { time_nanos: -7, ..question(MAP) }, Code::InvalidArgument, ["time", "1970"]),
        (with(GridOutput::Threshold(1.5)), Code::InvalidArgument, ["threshold", "1.5"]),
        (with(GridOutput::Threshold(-0.5)), Code::InvalidArgument, ["threshold", "-0.5"]),
        (
            GridQuery { model: model(ModelKind::Auto, Some(16)), ..question(MAP) },
            Code::InvalidArgument,
            ["order", "16"],
        ),
        // Nine cells up to the end of the ray, and this one.
        (question(MAP), Code::ResourceExhausted, ["10", "max_predictions"]),
    ] {
        refused(&client, &query, code, &words).await;
    }
    let estimate = client.estimate_grid(&question(MAP)).await.expect("an estimate is cheap");
    assert_eq!((estimate.tiles, estimate.cells), (2, 10));
    for (cell, code) in [
        ("cell/0/9/0", None),
        ("cell/0/90/0", Some(Code::NotFound)),
        ("cell/0/9", Some(Code::InvalidArgument)),
        ("cell/0/9/x", Some(Code::InvalidArgument)),
        ("cell/0/9/99999999999", Some(Code::InvalidArgument)),
    ] {
        match (client.describe_model(MAP, cell).await, code) {
            (Ok(model), None) => assert_eq!((model.last_value, model.observations), (Some(1.0), 1)),
            (Err(Error::Server(error)), Some(expected)) => {
                assert_eq!(error.code, expected, "{error}");
                assert!(error.message.contains(cell), "{cell:?} is not in {error}");
            }
            (other, _) => panic!("{cell}: {other:?}"),
        }
    }
    // A map without a grid refuses scans.
    let options = tidemap_client::observe::ProducerOptions::new("robot", "", "bare");
    let mut astray = Producer::open(&client, options).await.expect("a Welcome");
    astray.send_scan(NOON_NANOS, cloud(&[1.0, 0.0, 0.0])).await.expect("taken");
    astray.flush().await.expect("refused by itself");
    let refusals = astray.take_refusals();
    assert_eq!(refusals.iter().map(|refusal| refusal.reason).collect::<Vec<_>>(), [Some(RefusalReason::NoGrid)]);
}

async fn refused(client: &Client, query: &GridQuery, code: Code, words: &[&str]) {
    match client.predict_grid(query).await {
        Err(Error::Server(error)) => {
            assert_eq!(error.code, code, "{error}");
            for word in words {
                assert!(error.message.contains(word), "{word:?} is not in {error}");
            }
        }
        other => panic!("{query:?} should be refused: {other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_rays_beyond_all_bounds_are_refused_and_short_ones_go_on() {
    let (_data, daemon) = office(coarse()).await;
    let mut robot = producer(&daemon, "robot").await;
    let far = |xyz_m: &[f32], position_m: [f64; 3]| {
        let pose = Isometry3::from(Translation3::from(position_m));
        Scan::Cloud(PointCloud { pose, xyz_m: xyz_m.to_vec(), ..PointCloud::default() })
    };
    let scans = [
        far(&[1e6, 0.0, 0.0], [0.25; 3]),
        far(&[f32::MAX, f32::MAX, f32::MAX], [0.25; 3]),
        far(&[1.0, 0.0, 0.0], [1e300, 0.0, 0.0]),
        ranges(&[2.0; 4]),
    ];
    for (minute, scan) in (0..).zip(scans) {
        robot.send_scan(NOON_NANOS + minute * MINUTE_NANOS, scan).await.expect("taken");
    }
    robot.flush().await.expect("the stream goes on");
    let refusals = robot.take_refusals();
    let numbers: Vec<u64> = refusals.iter().map(|refusal| refusal.sequence).collect();
    assert_eq!(numbers, [1, 2, 3], "{refusals:?}");
    assert!(refusals[..2].iter().all(|refusal| refusal.detail.contains("max_range_m")), "{refusals:?}");
    let summary = summary(&daemon).await;
    assert_eq!((summary.scans, summary.cell_observations), (1, 17), "four arms of four cells and the middle");
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
}
