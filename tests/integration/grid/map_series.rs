//! Maps of real robots on the command line: series of Nav2 maps, their probabilities, and files of other kinds.
//!
//! Invariant: the files are made by hand, as map savers write them.

use std::{fs, io::Write as _, path::Path};

use flate2::{Compression, write::GzEncoder};
use tempfile::TempDir;
use tidemap_client::maps::{GridSpec, NewMap, Retention};
use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
};

/// The map of these tests.
const MAP: &str = "hall";

/// A daemon with a flat grid of 0.05 m that keeps its scans, in Berlin.
async fn hall() -> (TempDir, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let grid = GridSpec { is_flat: true, retention: Retention::Forever, ..GridSpec::new(0.05) };
    let zone = Some("Europe/Berlin".to_owned());
    let map = NewMap { name: MAP.to_owned(), time_zone: zone, grid: Some(grid), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    (data, daemon)
}

/// Writes a map of 4 x 2 pixels of this mode, and returns the path of its YAML file.
fn saved(folder: &Path, name: &str, mode: &str, pixels: [u8; 8]) -> String {
    let image = [&b"P5\n4 2\n255\n"[..], &pixels].concat();
    fs::write(folder.join(format!("{name}.pgm")), image).expect("an image");
    let thresholds = if mode == "scale" { "1.0\nfree_thresh: 0.0" } else { "0.65\nfree_thresh: 0.196" };
    let yaml = format!(
        "image: {name}.pgm\nmode: {mode}\nresolution: 0.05\norigin: [-15.2, 3.05, 0.0]\nnegate: 0\n\
         occupied_thresh: {thresholds}\n"
    );
    let path = folder.join(format!("{name}.yaml"));
    fs::write(&path, yaml).expect("a file of settings");
    path.to_str().expect("a path of text").to_owned()
}

fn observe(daemon: &Daemon, files: &[String], more: &[&str]) -> Outcome {
    let words = ["grid", "observe", MAP, "--producer", "robot"];
    cli::tidemap(daemon, words.into_iter().chain(files.iter().map(String::as_str)).chain(more.iter().copied()))
}

const TRINARY: [u8; 8] = [0, 254, 254, 205, 0, 0, 254, 205];

#[tokio::test(flavor = "multi_thread")]
async fn maps_of_a_series_have_the_times_of_their_names() {
    let (data, daemon) = hall().await;
    let names = ["hall_20250310_100000", "hall_20250310_110000", "hall_20250310_090000"];
    let files = names.map(|name| saved(data.path(), name, "trinary", TRINARY));
    let pattern = ["--times-from", "hall_%Y%m%d_%H%M%S.yaml"];
    observe(&daemon, &files, &pattern).fails(2, &["hall_20250310_100000.yaml", "--local", "--utc"]);
    observe(&daemon, &files, &["--times-from", "map_%s.yaml"]).fails(2, &["hall_20250310_100000.yaml", "map_%s.yaml"]);
    observe(&daemon, &files, &["--at", "2025-03-10T09:00:00Z"]).fails(2, &["--every", "--times-from"]);
    let sent = observe(&daemon, &files, &[&pattern[..], &["--local"]].concat());
    assert_eq!((sent.table().number("scans"), sent.table().number("cells")), (3.0, 18.0));
    assert!(sent.stderr.contains("6 of 24 pixels are unknown"), "{}", sent.stderr);
    // Nine in Berlin is eight UTC. The cell at -15.2, 3.05 is cell -304, 61.
    let words =
        ["reconstruct", MAP, "cell/-304/61/0", "--from", "2025-03-10T00:00:00Z", "--to", "2025-03-11T00:00:00Z"];
    let kept = cli::tidemap(&daemon, words).table();
    assert_eq!(kept.column("time"), ["1741593600", "1741597200", "1741600800"]);

    let list = data.path().join("times.csv");
    fs::write(&list, "file,time\nhall_20250310_090000.yaml,2025-03-11T09:00:00+01:00\n").expect("a list");
    let list = list.to_str().expect("a path of text");
    observe(&daemon, &files, &["--times-file", list, "--label", "b"])
        .fails(1, &["times.csv", "no time for \"hall_2025"]);
    let one = observe(&daemon, &files[2..], &["--times-file", list, "--label", "b"]).table();
    assert_eq!(one.number("scans"), 1.0);
    let numbered = ["m_1", "m_2", "m_4"].map(|name| saved(data.path(), name, "trinary", TRINARY));
    let every = ["--at", "2025-03-12T09:00:00Z", "--every", "1h", "--label", "c"];
    let gap = observe(&daemon, &numbered, &every);
    assert_eq!(gap.table().number("scans"), 3.0);
    assert!(gap.stderr.contains("gap from m_2.yaml to m_4.yaml"), "{}", gap.stderr);
}

#[tokio::test(flavor = "multi_thread")]
async fn probabilities_of_a_map_are_rounded_or_left_out_and_counted() {
    let (data, daemon) = hall().await;
    let at = ["--at", "2025-03-10T09:00:00Z"];
    // 1 - pixel / 255: occupied, .8, .6, .5, .4, .2, free, free.
    let file = [saved(data.path(), "scale", "scale", [0, 51, 102, 127, 153, 204, 255, 255])];
    let sent = observe(&daemon, &file, &at);
    assert_eq!(sent.table().number("cells"), 8.0, "nothing is dropped");
    assert!(sent.stderr.contains("5 of 8 pixels are between free and occupied"), "{}", sent.stderr);
    assert!(sent.stderr.contains("3 count as occupied, from 0.5 on, and 2 as free"), "{}", sent.stderr);
    let left = observe(&daemon, &file, &[&at[..], &["--between", "leave", "--label", "left"]].concat());
    assert_eq!(left.table().number("cells"), 3.0);
    assert!(left.stderr.contains("5 of 8 pixels") && left.stderr.contains("not used"), "{}", left.stderr);
    let raw = [saved(data.path(), "raw", "raw", [0, 100, 30, 70, 255, 101, 50, 49])];
    let sent = observe(&daemon, &raw, &[&at[..], &["--between", "0.65", "--label", "raw"]].concat());
    assert_eq!(sent.table().number("cells"), 6.0);
    for words in ["2 of 8 pixels are unknown", "4 of 8 pixels", "1 count as occupied, from 0.65 on, and 3 as free"] {
        assert!(sent.stderr.contains(words), "{words}: {}", sent.stderr);
    }
}

/// The map at a time, as written: size, origin line, and pixels.
fn written(daemon: &Daemon, folder: &Path, more: &[&str]) -> ([usize; 2], String, Vec<u8>) {
    let out = folder.join("out.pgm");
    let path = out.to_str().expect("a path of text");
    let words = ["grid", "predict", MAP, "--at", "2025-03-10T09:00:00Z", "--out", path];
    cli::tidemap(daemon, words.iter().chain(more)).table();
    let image = fs::read(&out).expect("an image");
    let header: Vec<&[u8]> = image.splitn(4, |&byte| byte == b'\n').collect();
    let size = std::str::from_utf8(header[1]).expect("text").split(' ').map(|text| text.parse().expect("a number"));
    let yaml = fs::read_to_string(folder.join("out.yaml")).expect("settings");
    let origin = yaml.lines().find(|line| line.starts_with("origin")).unwrap_or_default().to_owned();
    (size.collect::<Vec<usize>>().try_into().expect("two numbers"), origin, header[3].to_vec())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_comes_out_as_it_came_in() {
    let (data, daemon) = hall().await;
    // Unknown cells all around, so that no known cell determines the size of the map.
    let pixels = [205, 205, 205, 205, 205, 0, 254, 205];
    let file = [saved(data.path(), "hall", "trinary", pixels)];
    let at = ["--at", "2025-03-10T09:00:00Z"];
    observe(&daemon, &file, &at).table();
    let latest = ["--model", "latest"];
    let expected = ([4, 2], "origin: [-15.2, 3.05, 0.0]".to_owned(), pixels.to_vec());
    assert_eq!(written(&daemon, data.path(), &latest), expected);
    cli::tidemap(&daemon, ["update", MAP]).table();
    assert_eq!(written(&daemon, data.path(), &[]), expected, "after an update");
    let shown = cli::tidemap(&daemon, ["map", "show", MAP]);
    assert_eq!(shown.code, Some(0), "{}", shown.stderr);
    daemon.stop_in_order();
    let daemon = Launch::on(data.path()).start();
    assert_eq!(written(&daemon, data.path(), &[]), expected, "after a restart");
    // Probabilities: what is between is rounded, and nothing else changes.
    let file = [saved(data.path(), "scale", "scale", [0, 255, 0, 255, 0, 0, 255, 255])];
    observe(&daemon, &file, &["--at", "2025-03-10T10:00:00Z", "--label", "scale"]).table();
    let (_, origin, pixels) = written(&daemon, data.path(), &["--model", "latest", "--pgm-mode", "scale"]);
    assert_eq!((origin, pixels), (expected.1, vec![0, 255, 0, 255, 0, 0, 255, 255]));
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_requested_cells_are_counted() {
    let data = tempfile::tempdir().expect("a folder");
    // Tiles of a grid that is not flat have 512 cells; the map has one layer of them.
    let daemon = Launch::on(data.path()).setting("max_predictions", 100_000).start();
    let map = NewMap { name: MAP.to_owned(), grid: Some(GridSpec::new(0.05)), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    let (width, height) = (403, 302);
    let saved = |name: &str, height: usize| {
        let image = [format!("P5\n{width} {height}\n255\n").into_bytes(), vec![254; width * height]].concat();
        fs::write(data.path().join(format!("{name}.pgm")), image).expect("an image");
        let yaml = format!(
            "image: {name}.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        );
        let path = data.path().join(format!("{name}.yaml"));
        fs::write(&path, yaml).expect("a file of settings");
        path.to_str().expect("a path of text").to_owned()
    };
    let at = ["--at", "2025-03-10T09:00:00Z"];
    observe(&daemon, &[saved("part", 200)], &at).table();
    let (size, _, _) = written(&daemon, data.path(), &[]);
    assert_eq!(size, [width, 200], "80,600 cells are less than 100,000");
    observe(&daemon, &[saved("whole", height)], &[&at[..], &["--label", "whole"]].concat()).table();
    let out = data.path().join("all.pgm");
    let words = ["grid", "predict", MAP, "--at", "2025-03-10T09:00:00Z", "--out", out.to_str().expect("text")];
    let refused = cli::tidemap(&daemon, words);
    refused.fails(1, &["121706", "100000", "--region X0:X1,Y0:Y1", "--z MIN:MAX", "flat"]);
    let part = written(&daemon, data.path(), &["--region", "0:5,0:5"]);
    assert_eq!(part.0, [100, 100]);
}

#[tokio::test(flavor = "multi_thread")]
async fn other_files_name_the_command_that_takes_them() {
    let (data, daemon) = hall().await;
    let file = |name: &str, bytes: &[u8]| {
        let path = data.path().join(name);
        fs::write(&path, bytes).expect("a file");
        path.to_str().expect("a path of text").to_owned()
    };
    let yaml = saved(data.path(), "hall", "trinary", TRINARY);
    let sends = |file: &str| cli::tidemap(&daemon, ["observe", MAP, file, "--producer", "robot"]);
    for image in [&yaml, &yaml.replace(".yaml", ".pgm"), &file("scan", b"# .PCD v0.7 - Point Cloud Data\n")] {
        sends(image).fails(2, &["tidemap grid observe sends it"]);
    }
    sends(&file("run.mcap", b"\x89MCAP0\r\n\x01\x00")).fails(2, &["run.mcap", "recording of ROS"]);
    let tmap2 = "meta: {last_updated: 2022-03-02_10-07-31}\nname: halls\nnodes:\n- meta: {node: A}\n  node:\n    edges:\n    \
                 - {action: NavigateToPose, edge_id: A_B, node: B}\n    name: A\n    pose: {position: {x: 0, y: 0, z: 0}}\n\
                 - node: {name: B, edges: [], pose: {position: {x: 3, y: 4, z: 0}}}\n";
    let tmap2 = file("halls.tmap2", tmap2.as_bytes());
    sends(&tmap2).fails(2, &["halls.tmap2", "tidemap topology load"]);
    let loaded = cli::tidemap(&daemon, ["topology", "load", MAP, &tmap2]).table();
    assert_eq!((loaded.number("nodes"), loaded.number("edges")), (2.0, 1.0));

    let rows = "time,state,value\n2025-03-10T09:00:00Z,door,1\n2025-03-10T10:00:00Z,door,2\n";
    let wide: Vec<u8> = rows.encode_utf16().flat_map(u16::to_le_bytes).collect();
    sends(&file("wide.csv", &[&[0xff, 0xfe][..], &wide].concat())).fails(2, &["wide.csv", "UTF-16LE", "iconv"]);
    let mut packer = GzEncoder::new(Vec::new(), Compression::fast());
    packer.write_all(rows.as_bytes()).expect("room");
    let packed = file("log.csv.gz", &packer.finish().expect("room"));
    let refused = data.path().join("refused.csv");
    let refused = refused.to_str().expect("a path of text");
    let sent = cli::tidemap(&daemon, ["observe", MAP, &packed, "--producer", "robot", "--refused", refused]);
    let counts = sent.table_with(1);
    assert_eq!((counts.number("accepted"), counts.number("refused")), (1.0, 1.0));
    let kept = fs::read_to_string(refused).expect("the refused row");
    assert!(kept.contains("2025-03-10T10:00:00Z,door,2"), "{kept}");
}

/// The thresholds that map savers of Nav2 write.
fn with_a_quarter(path: &str) {
    let text = fs::read_to_string(path).expect("settings").replace("free_thresh: 0.196", "free_thresh: 0.25");
    fs::write(path, text).expect("settings");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_of_maps_is_compared_at_two_times_in_three_commands() {
    let (data, daemon) = hall().await;
    let folder = data.path().join("saved-maps");
    fs::create_dir(&folder).expect("a folder");
    // Free at night, occupied by day; a map of each hour of two days, images and settings in one folder.
    for (day, hour) in (10..12).flat_map(|day| (0..24).map(move |hour| (day, hour))) {
        let middle = if (8..20).contains(&hour) { 0 } else { 254 };
        let pixels = [0, 254, middle, 205, 0, 0, 254, 205];
        with_a_quarter(&saved(&folder, &format!("hall_202503{day}_{hour:02}0000"), "trinary", pixels));
    }
    let maps = [folder.to_str().expect("a path of text").to_owned()];
    let pattern = ["--times-from", "hall_%Y%m%d_%H%M%S.yaml", "--local"];
    let sent = observe(&daemon, &maps, &pattern);
    assert_eq!((sent.table().number("scans"), sent.table().number("cells")), (48.0, 48.0 * 8.0));
    assert!(sent.stderr.contains("48 images of maps are left out"), "{}", sent.stderr);
    assert!(sent.stderr.contains("96 of 384 pixels have the value 205"), "{}", sent.stderr);
    assert!(sent.stderr.contains("count as free with free_thresh 0.25"), "{}", sent.stderr);
    let unknown = observe(&daemon, &maps, &[&pattern[..], &["--unknown-205", "--label", "b"]].concat());
    assert_eq!(unknown.table().number("cells"), 48.0 * 6.0);
    assert!(unknown.stderr.contains("96 of 384 pixels are unknown"), "{}", unknown.stderr);

    let predict = ["grid", "predict", MAP, "--model", "latest"];
    let ask = |more: &[&str]| cli::tidemap(&daemon, predict.iter().chain(more).copied());
    let day = ["--date", "2025-03-11", "--at", "10:00", "--at", "22:00", "--picture"];
    let drawn = ask(&day);
    assert!(drawn.stdout.contains("Tue 2025-03-11 10:00") && drawn.stdout.contains("22:00"), "{}", drawn.stdout);
    assert!(drawn.stdout.contains("difference, the second minus the first"), "{}", drawn.stdout);
    let picture = data.path().join("both.png");
    let picture = picture.to_str().expect("a path of text");
    let written = ask(&[&day[..], &[picture]].concat());
    assert_eq!(written.table().number("cells"), 8.0);
    assert!(fs::read(picture).is_ok_and(|file| file.starts_with(b"\x89PNG")));
    ask(&["--at", "2025-03-11T10:00", "--out", "x.pgm"]).fails(2, &["--local"]);
    ask(&["--date", "2025-03-11", "--out", picture]).fails(2, &["--out takes one time, and there are 24"]);
    ask(&["--at", "10:00", "--picture"]).fails(2, &["--date today --at 10:00"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_at_a_time_that_does_not_exist_is_refused_alone() {
    let (data, daemon) = hall().await;
    let names = ["hall_20250330_013000", "hall_20250330_023000", "hall_20250330_033000"];
    let files = names.map(|name| saved(data.path(), name, "trinary", TRINARY));
    let sent = observe(&daemon, &files, &["--times-from", "hall_%Y%m%d_%H%M%S.yaml", "--local"]);
    let counts = sent.table_with(1);
    assert_eq!(["scans", "cells", "refused"].map(|column| counts.number(column)), [2.0, 12.0, 1.0]);
    for words in ["hall_20250330_023000.yaml is refused", "does not exist in Europe/Berlin"] {
        assert!(sent.stderr.contains(words), "{words}: {}", sent.stderr);
    }
}
