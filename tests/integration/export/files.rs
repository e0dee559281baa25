//! Recordings in MCAP, and maps and masks for Nav2.
//!
//! Invariant: images are read as the documentation of Nav2's map server defines.

use std::{collections::BTreeMap, fs, path::Path};

use serde_json::Value;
use tidemap_tests::cli::tidemap;

use super::{Cells, DAY, Home, MAP, NOON, known_cells};

const HOUR_NANOS: u64 = 3_600_000_000_000;
/// 2025-01-28T00:00:00Z.
const MIDNIGHT_NANOS: u64 = 1_738_022_400_000_000_000;

#[test]
fn a_recording_has_the_map_of_every_time() {
    let home = Home::new();
    let (path, counts) = home.export("day.mcap", &DAY);
    let counts: Vec<(&str, f64)> = counts.iter().map(|(content, count)| (content.as_str(), *count)).collect();
    // door, light, and for each of the eight edges its success and its pace.
    assert_eq!(counts[..3], [("grid", 4.0), ("map", 4.0), ("states", counts[2].1)]);
    assert_eq!(counts[3], ("topology", 4.0));

    let bytes = fs::read(&path).expect("the recording");
    let summary = mcap::Summary::read(&bytes).expect("MCAP").expect("an index");
    let states = summary.channels.values().filter(|channel| channel.topic.starts_with("/states/")).count();
    assert_eq!(counts[2].1, 4.0 * states as f64, "every state has a value for every time");
    let expected: Vec<Cells> =
        ["00", "06", "12", "18"].map(|hour| home.cells(&format!("2025-01-28T{hour}:00:00Z"))).into();
    assert_ne!(expected[0], expected[2], "the fifth point moves");
    let (mut grids, mut doors, mut graphs) = (Vec::new(), Vec::new(), 0);
    let mut times = BTreeMap::<String, Vec<u64>>::new();
    for message in mcap::MessageStream::new(&bytes).expect("MCAP") {
        let message = message.expect("a message");
        times.entry(message.channel.topic.clone()).or_default().push(message.log_time);
        match message.channel.topic.as_str() {
            "/grid" => grids.push(cells_of_grid(&json(&message.data))),
            "/states/door" => doors.push(json(&message.data)["value"].as_f64().expect("a number")),
            "/topology" => {
                let graph: Value = json(json(&message.data)["geojson"].as_str().expect("a text").as_bytes());
                assert_eq!(graph["type"], "FeatureCollection");
                graphs += 1;
            }
            _ => {}
        }
    }
    assert_eq!((grids, graphs), (expected, 4));
    let predicted = home.run(&[&["predict", MAP, "door"], &DAY[..]].concat()).table();
    // The reader of JSON may miss the last bit.
    let predicted = predicted.numbers("probability");
    assert_eq!(doors.len(), predicted.len());
    assert!(doors.iter().zip(&predicted).all(|(door, predicted)| (door - predicted).abs() < 1e-12), "{doors:?}");
    let day: Vec<u64> = (0..4).map(|step| MIDNIGHT_NANOS + step * 6 * HOUR_NANOS).collect();
    assert!(times.len() == 3 + states && times.values().all(|times| *times == day), "{times:?}");
}

fn json(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).expect("JSON")
}

/// The cells of a `foxglove.Grid` with a field of signed bytes.
fn cells_of_grid(grid: &Value) -> Cells {
    assert_eq!((&grid["cell_stride"], &grid["fields"][0]["type"]), (&1.into(), &2.into()));
    let percents: Vec<i32> =
        base64(grid["data"].as_str().expect("a text")).iter().map(|byte| i32::from(*byte as i8)).collect();
    let number = |value: &Value| value.as_f64().expect("a number");
    let width = grid["column_count"].as_u64().expect("a width") as usize;
    let origin = &grid["pose"]["position"];
    known_cells(&percents, width, [number(&origin["x"]), number(&origin["y"])], number(&grid["cell_size"]["x"]))
}

fn base64(text: &str) -> Vec<u8> {
    let letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut bits, mut count, mut bytes) = (0_u32, 0, Vec::new());
    for letter in text.trim_end_matches('=').chars() {
        bits = bits << 6 | letters.find(letter).expect("a letter of base64") as u32;
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    bytes
}

#[test]
fn a_recording_has_what_is_requested_and_replaces_a_file_only_when_it_is_complete() {
    let home = Home::new();
    let (path, counts) = home.export("part.mcap", &["--at", NOON, "--content", "states", "--state", "d*"]);
    assert_eq!(counts, BTreeMap::from([("states".to_owned(), 1.0)]));
    let before = fs::read(&path).expect("the recording");
    let path = path.to_str().expect("text");
    let export = |words: &[&str]| tidemap(&home.daemon, [&["export", MAP, path], words].concat());
    // ROS 2 has no time after 2038: the maps before are written, then the export fails.
    export(&["--at", &format!("{NOON},2040-01-01T00:00:00Z"), "--content", "map"]).fails(1, &["2038"]);
    assert_eq!(fs::read(path).expect("the recording"), before);
    let left = fs::read_dir(home.folder.path()).expect("a folder").map(|entry| entry.expect("an entry").file_name());
    let left: Vec<_> = left.filter(|name| name.to_string_lossy().starts_with(".tidemap")).collect();
    assert!(left.is_empty(), "{left:?}");

    export(&["--at", NOON, "--content", "states", "--state", "x*"]).fails(2, &["no state", "x*"]);
    export(&["--at", NOON, "--mask", "speed"]).fails(2, &["--mask goes with a .yaml file only"]);
    export(&["--at", NOON, "--content", "map", "--state", "door"]).fails(2, &["--state goes with --content states"]);
    home.run(&["map", "create", "empty"]);
    tidemap(&home.daemon, ["export", "empty", path, "--at", NOON]).fails(2, &["empty", "no grid"]);
    tidemap(&home.daemon, ["export", MAP, "a.txt", "--at", NOON]).fails(2, &[".mcap, .yaml or .geojson"]);
    tidemap(&home.daemon, ["export", MAP, "a.yaml", "--at", &format!("{NOON},{NOON}")]).fails(2, &["one time"]);
    tidemap(&home.daemon, ["export", MAP, "/nowhere/a.geojson", "--at", NOON]).fails(1, &["/nowhere/a.geojson"]);
}

/// A map or mask of Nav2: its known cells by the mode of its YAML file.
fn read_image(yaml: &Path) -> Cells {
    let settings: BTreeMap<String, Value> =
        serde_saphyr::from_str(&fs::read_to_string(yaml).expect("the YAML file")).expect("YAML");
    let image = yaml.with_file_name(settings["image"].as_str().expect("the image"));
    let bytes = fs::read(image).expect("the image");
    let ends: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at].is_ascii_whitespace()).take(4).collect();
    let head = String::from_utf8(bytes[..ends[3]].to_vec()).expect("text");
    let words: Vec<&str> = head.split_whitespace().collect();
    assert_eq!((words[0], words[3]), ("P5", "255"));
    let width: usize = words[1].parse().expect("a width");
    let number = |name: &str| settings[name].as_f64().expect("a number");
    assert_eq!(number("negate"), 0.0);
    let percent = |pixel: u8| {
        let occupied = 1.0 - f64::from(pixel) / 255.0;
        match settings["mode"].as_str() {
            Some("raw") if pixel <= 100 => i32::from(pixel),
            Some("trinary") if occupied > number("occupied_thresh") => 100,
            Some("trinary") if occupied < number("free_thresh") => 0,
            _ => -1,
        }
    };
    // The image begins at the top.
    let rows = bytes[ends[3] + 1..].chunks_exact(width).rev();
    let percents: Vec<i32> = rows.flatten().map(|&pixel| percent(pixel)).collect();
    let origin = |axis: usize| settings["origin"][axis].as_f64().expect("a number");
    known_cells(&percents, width, [origin(0), origin(1)], number("resolution"))
}

#[test]
fn maps_and_masks_for_nav2_are_those_of_their_time() {
    let home = Home::new();
    let night = "2025-01-28T02:00:00Z";
    let cells = home.cells(night);
    let (path, _) = home.export("night.yaml", &["--at", night]);
    let decided = |(_, percent): &(&[i64; 2], &i32)| **percent <= 25 || **percent >= 65;
    let expected: Cells =
        cells.iter().filter(decided).map(|(place, percent)| (*place, if *percent >= 65 { 100 } else { 0 })).collect();
    assert_eq!(read_image(&path), expected);

    home.run(&["no-go", "add", MAP, "wet", "0.1,0.1:0.9,0.1:0.9,0.4:0.1,0.4"]);
    let (path, _) = home.export("keepout.yaml", &["--at", night, "--mask", "keepout"]);
    let mask = read_image(&path);
    for (place, percent) in &mask {
        // The area lies in the two cells of 0.5 m from 0 to 1 m.
        let is_wet = place == &[250, 250] || place == &[750, 250];
        let is_occupied = cells.get(place).is_some_and(|percent| *percent >= 65);
        assert_eq!(*percent, if is_wet || is_occupied { 100 } else { 0 }, "{place:?}");
    }
    assert!(mask.len() > cells.len(), "unknown cells are allowed");

    let (path, _) = home.export("speed.yaml", &["--at", night, "--mask", "speed", "--slowest", "0.3"]);
    let mask = read_image(&path);
    assert_eq!(mask.keys().collect::<Vec<_>>(), cells.keys().collect::<Vec<_>>(), "unknown cells stay unknown");
    for (place, percent) in &mask {
        let limit = (100 - cells[place]).max(30);
        let is_it = if limit == 100 { *percent == 0 } else { (percent - limit).abs() <= 1 };
        assert!(is_it, "{place:?}: {percent} for {}", cells[place]);
    }
    assert!(mask.values().any(|percent| *percent == 30), "{mask:?}");
}
