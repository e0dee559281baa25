//! Pictures of grids and GeoJSON of topologies, as a browser or a script gets them from the HTTP port.
//!
//! Invariant: expected pixels and forecasts come from what was observed, or from the command line.

use std::io::{Cursor, Read as _};

use prost::Message as _;
use serde_json::Value;
use tempfile::{TempDir, tempdir};
use tidemap_client::{
    maps::{CellBox, GridSpec, NewMap},
    observe::{
        Producer, ProducerOptions,
        scan::Scan,
        tiles::{Mask, TileIndex, TileMasks},
    },
};
use tidemap_proto::v1;
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    oracle,
    tokens::Tokens,
    web::{Answer, request},
};

use super::grpc_web;

/// The colour in which RViz and Nav2 show free cells.
const FREE: [u8; 3] = [255; 3];
const OCCUPIED: [u8; 3] = [0; 3];
const UNKNOWN: [u8; 3] = [205; 3];
/// A wall below the colours of another layer.
const MUTED_WALL: [u8; 3] = [40, 40, 44];

/// Noon of a Monday.
const NOON_SECS: i64 = 1_767_614_400;

fn get(daemon: &Daemon, path: &str, headers: &[(&str, &str)]) -> Answer {
    request(&daemon.http, "GET", &format!("/api/v1/maps/{path}"), headers, b"")
}

/// A flat grid of 0.5 m, with a map of one tile at x = 4 m: its lowest row free, the next one occupied, the others
/// unknown.
async fn daemon_with_a_grid() -> (TempDir, Daemon) {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let grid = GridSpec { is_flat: true, ..GridSpec::new(0.5) };
    let map = NewMap { name: "yard".to_owned(), grid: Some(grid), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let options = ProducerOptions::new("robot", "", "yard");
    let mut producer = Producer::open(&daemon.client(), options).await.expect("a Welcome");
    let masks = TileMasks::clipped(Mask([0xFFFF, 0, 0, 0, 0, 0, 0, 0]), Mask([0xFF00, 0, 0, 0, 0, 0, 0, 0]));
    let index = TileIndex { x: 1, y: 0, z: 0 };
    let shown = CellBox { min: [8, 0, 0].into(), max: [16, 8, 1].into() };
    let scan = Scan::Map { tiles: vec![(index, masks)], shown };
    producer.send_scan(NOON_SECS * 1_000_000_000, scan).await.expect("taken");
    producer.flush().await.expect("durable");
    assert_eq!(producer.take_refusals(), []);
    oracle::run_update(&daemon.client(), "yard", Some((NOON_SECS + 60) * 1_000_000_000)).await;
    (data, daemon)
}

/// A grid of 0.5 m with heights: one tile whose lowest layer, the floor, is occupied, and whose layers from 0.5 m to
/// 1.5 m are free but for one column.
async fn daemon_with_heights() -> (TempDir, Daemon) {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let map = NewMap { name: "hall".to_owned(), grid: Some(GridSpec::new(0.5)), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let options = ProducerOptions::new("robot", "", "hall");
    let mut producer = Producer::open(&daemon.client(), options).await.expect("a Welcome");
    let masks =
        TileMasks::clipped(Mask([u64::MAX, u64::MAX, u64::MAX, 0, 0, 0, 0, 0]), Mask([u64::MAX, 0, 1, 0, 0, 0, 0, 0]));
    let scan = Scan::Tiles(vec![(TileIndex { x: 0, y: 0, z: 0 }, masks)]);
    producer.send_scan(NOON_SECS * 1_000_000_000, scan).await.expect("taken");
    producer.flush().await.expect("durable");
    oracle::run_update(&daemon.client(), "hall", Some((NOON_SECS + 60) * 1_000_000_000)).await;
    (data, daemon)
}

#[tokio::test(flavor = "multi_thread")]
async fn heights_of_a_grid_are_selected() {
    let (_data, daemon) = daemon_with_heights().await;
    let get = |ranges: &str| get(&daemon, &format!("hall/grid.png?at={}{ranges}", NOON_SECS + 3_600), &[]);
    let column = [vec![FREE; 7 * 8], vec![OCCUPIED], vec![FREE; 7]].concat();
    assert_eq!(pixels(&get("&z=0.5:1.8")), (8, 8, column.clone()), "above the floor");
    assert_eq!(pixels(&get("&z=0.5:1")), (8, 8, vec![FREE; 64]));
    assert_eq!(pixels(&get("")), (8, 8, vec![OCCUPIED; 64]), "from 0.1 m, which is within the floor's cells");
    let none = get("&z=9:10");
    assert!(none.code == 400 && none.text().contains("0.00 m to 1.50 m"), "{none:?}");
}

/// Width, height and pixels.
fn pixels(answer: &Answer) -> (u32, u32, Vec<[u8; 3]>) {
    assert_eq!((answer.code, answer.headers["content-type"].as_str()), (200, "image/png"), "{}", answer.text());
    let mut reader = png::Decoder::new(Cursor::new(&answer.body)).read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
    let frame = reader.next_frame(&mut pixels).expect("a frame");
    assert_eq!((frame.color_type, frame.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
    let colours = pixels.chunks_exact(3).map(|bands| [bands[0], bands[1], bands[2]]).collect();
    (frame.width, frame.height, colours)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grid_is_a_picture_at_a_time() {
    let (_data, daemon) = daemon_with_a_grid().await;
    let later = NOON_SECS + 3_600;
    // Where nothing is uncertain or changes, other layers show the same map, its walls a little less dark.
    for (layer, wall) in [
        ("", OCCUPIED),
        ("&layer=probability", OCCUPIED),
        ("&layer=seen", OCCUPIED),
        ("&layer=entropy", MUTED_WALL),
        ("&layer=difference", MUTED_WALL),
    ] {
        let answer = get(&daemon, &format!("yard/grid.png?at={later}{layer}"), &[]);
        let expected = [vec![UNKNOWN; 6 * 8], vec![wall; 8], vec![FREE; 8]].concat();
        assert_eq!(pixels(&answer), (8, 8, expected), "{layer}");
    }
    let part = get(&daemon, "yard/grid.png?at=2026-01-05T13:00:00Z&x=5:6&y=0:0.5&scale=3", &[]);
    assert_eq!(pixels(&part), (6, 3, vec![FREE; 18]));
    assert_eq!(part.headers["tidemap-lower-left-m"], "5 0");
    assert!(part.headers["tidemap-metres-per-pixel"].starts_with("0.1666"), "{part:?}");

    // For people: larger cells, and below them what the colours mean.
    let framed = get(&daemon, &format!("yard/grid.png?at={later}&legend=true"), &[]);
    assert_eq!((framed.code, framed.headers["tidemap-metres-per-pixel"].as_str()), (200, "0.03125"), "{framed:?}");
    let mut reader = png::Decoder::new(Cursor::new(&framed.body)).read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
    let frame = reader.next_frame(&mut pixels).expect("a frame");
    assert_eq!(frame.color_type, png::ColorType::Rgb);
    assert!(frame.width > 8 * 16 && frame.height > 8 * 16 + 60, "{frame:?}");
    let at = |y: usize| &pixels[y * 16 * frame.width as usize * 3..][..3];
    assert_eq!((at(0), at(6), at(7)), (&UNKNOWN[..], &OCCUPIED[..], &FREE[..]));
    for wrong in ["legend=yes", "scale=0", "scale=17", "scale=wide"] {
        let answer = get(&daemon, &format!("yard/grid.png?{wrong}"), &[]);
        let value = wrong.split_once('=').expect("a value").1;
        assert!(answer.code == 400 && answer.text().contains(value), "{wrong}: {answer:?}");
    }

    let whole = get(&daemon, &format!("yard/grid.png?at={later}"), &[]);
    assert_eq!(whole.headers["cache-control"], "private, no-cache");
    let again = get(&daemon, &format!("yard/grid.png?at={later}"), &[("if-none-match", &whole.headers["etag"])]);
    assert_eq!((again.code, again.body.len()), (304, 0));
    assert_eq!(request(&daemon.http, "HEAD", "/api/v1/maps/yard/grid.png", &[], b"").code, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_that_cannot_be_made_give_the_reason() {
    let (_data, daemon) = daemon_with_a_grid().await;
    let empty = NewMap { name: "new".to_owned(), grid: Some(GridSpec::new(0.1)), ..NewMap::default() };
    daemon.client().create_map(empty).await.expect("a new map");
    let bare = NewMap { name: "bare".to_owned(), ..NewMap::default() };
    daemon.client().create_map(bare).await.expect("a new map");
    for (path, code, text) in [
        ("nowhere/grid.png", 404, "nowhere"),
        ("bare/grid.png", 400, "grid"),
        ("new/grid.png", 400, "no scans yet"),
        ("yard/grid.png?layer=heat", 400, "the layers are probability, entropy"),
        ("yard/grid.png?at=noon", 400, "is not a time"),
        ("yard/grid.png?time=5", 400, "the parameters are at, layer"),
        ("yard/grid.png?x=90:95", 400, "it goes from 4.00 m to 8.00 m"),
        ("yard/grid.png?scale=17", 400, "from 1 to 16"),
        ("yard/grid.png?than=5", 400, "layer=difference"),
        ("yard/topology.geojson", 400, "no nodes"),
        ("nowhere/topology.geojson?at=5", 404, "nowhere"),
        ("yard/topology.geojson?layer=5", 400, "the parameters are at, object"),
    ] {
        let answer = get(&daemon, path, &[]);
        assert_eq!(answer.code, code, "{path}: {}", answer.text());
        let error = answer.json()["error"].clone();
        assert!(error["message"].as_str().is_some_and(|message| message.contains(text)), "{path}: {error}");
        assert!(error["reason"].is_string() && error["code"].is_string(), "{path}: {error}");
    }
    let foreign = [("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "no-cors")];
    assert_eq!(get(&daemon, "yard/grid.png", &foreign).reason(), "FOREIGN_REQUEST");
    assert_eq!(get(&daemon, "yard/grid.png", &[("host", "evil.example")]).reason(), "FOREIGN_REQUEST");
    let followed = [("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "navigate")];
    assert_eq!(get(&daemon, "yard/grid.png", &followed).code, 200, "a link from elsewhere");
}

#[test]
fn a_picture_needs_the_role_of_predictions() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let [observer, planner] = ["observer", "planner"].map(|role| format!("Bearer {}", tokens.create(&[role], &[])));
    let data = work.path().join("data");
    let daemon = Launch::on(&data).setting("tokens_file", tokens.path.display()).start();
    for path in ["home/grid.png", "home/topology.geojson"] {
        assert_eq!(get(&daemon, path, &[]).reason(), "NO_TOKEN");
        assert_eq!(get(&daemon, path, &[("authorization", &observer)]).reason(), "NEEDS_ROLE");
        assert_eq!(get(&daemon, path, &[("authorization", &planner)]).reason(), "UNKNOWN_MAP");
    }
}

#[test]
fn a_topology_is_geojson_at_a_time() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    cli::tidemap(&daemon, ["map", "create", "flat"]).table();
    let topology = "node hall\nnode lab\nnode attic\nlink hall lab 20\nlink lab attic 30\n";
    cli::tidemap_reading(&daemon, ["topology", "load", "flat", "-"], topology).table();
    for (node, pose) in [("hall", "1,2"), ("lab", "4.5,-6")] {
        cli::tidemap(&daemon, ["topology", "edit", "set-node", "flat", node, "--position", pose]).table();
    }
    let mut rows = "time,state,value\n".to_owned();
    for hour in 0..240 {
        rows += &format!("{},hall,{}\n", NOON_SECS + hour * 3_600, u8::from(hour % 24 < 12));
    }
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    cli::tidemap(&daemon, ["update", "flat"]).table();
    let at = (NOON_SECS + 11 * 86_400).to_string();
    let answer = get(&daemon, &format!("flat/topology.geojson?at={at}"), &[]);
    assert_eq!((answer.code, answer.headers["content-type"].as_str()), (200, "application/geo+json"));
    let document = answer.json();
    assert!(document["tidemap"]["coordinates"].as_str().is_some_and(|text| text.contains("metres")));
    let features = document["features"].as_array().expect("features");
    let find = |key: &str, value: &str| -> Vec<&Value> {
        features.iter().filter(|feature| feature["properties"][key] == value).collect()
    };
    assert_eq!(find("name", "lab")[0]["geometry"]["coordinates"], serde_json::json!([4.5, -6.0]));
    assert!(find("name", "attic")[0]["geometry"].is_null());
    let presence = cli::tidemap(&daemon, ["predict", "flat", "hall", "--at", &at]).table();
    let presence_of_hall = find("name", "hall")[0]["properties"]["presence"].as_f64().expect("a number");
    assert!((presence_of_hall - presence.number("probability")).abs() < 1e-6, "{presence_of_hall} {presence:?}");
    let edges = find("from", "hall");
    let line = serde_json::json!([[1.0, 2.0], [4.5, -6.0]]);
    assert_eq!(edges[0]["geometry"], serde_json::json!({ "type": "LineString", "coordinates": line }));
    let route = cli::tidemap(&daemon, ["route", "flat", "hall", "lab", "--at", &at]).table();
    let success = edges[0]["properties"]["success"].as_f64().expect("a number");
    assert!((success - route.number("probability")).abs() < 1e-6, "{success} {route:?}");
    let again = [("if-none-match", answer.headers["etag"].as_str())];
    assert_eq!(get(&daemon, &format!("flat/topology.geojson?at={at}"), &again).code, 304);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_browser_gets_a_grid_compressed_if_it_accepts_that() {
    let (_data, daemon) = daemon_with_a_grid().await;
    let time = Some(prost_types::Timestamp { seconds: NOON_SECS + 3_600, nanos: 0 });
    let request = v1::PredictGridRequest { map: "yard".to_owned(), time, ..Default::default() }.encode_to_vec();
    let plain = grpc_web(&daemon, "QueryService/PredictGrid", &[], &request);
    assert_eq!((plain.code, plain.headers.get("content-encoding")), (200, None));
    assert!(plain.text().contains("grpc-status:0"), "{}", plain.text());

    let small = grpc_web(&daemon, "QueryService/PredictGrid", &[("accept-encoding", "gzip, br")], &request);
    assert_eq!(small.headers.get("content-encoding").map(String::as_str), Some("gzip"));
    let mut read = Vec::new();
    flate2::read::GzDecoder::new(small.body.as_slice()).read_to_end(&mut read).expect("gzip");
    assert_eq!(read, plain.body);
}
