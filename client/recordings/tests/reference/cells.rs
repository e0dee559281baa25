//! Scans, clouds and poses of real recordings in their places against an independent computation.
//!
//! Invariant: the compared data comes out of the converter, as an import takes it.

use std::{collections::BTreeSet, path::Path, sync::Arc};

use nalgebra::{Point3, Vector3};
use tidemap_recordings::{
    convert::{Clock, ConvertOptions, Converter, Item, Made, NotMade},
    kind::read,
    mapping::Mapping,
    plan::{Plan, Wishes, plan},
    recording::{RecordedMessage, Sink, Stopped, Topic},
    survey::{Survey, Surveyed},
};

use super::{beside, kind};

const CELL_M: f64 = 0.1;

/// Points, cells and checksums in the plane and in space where beams without a return are left out: ranges that are the
/// largest of the sensor, and points of zeros. They are of the program that made the references, with that rule.
const WITHOUT_MARKERS: [(&str, &str, [u64; 2], [&str; 2]); 4] = [
    ("turtlebot3", "/scan", [44_464, 364], ["95bee2a5", "196f2260"]),
    ("sick-radar", "/cloud", [45_804, 103], ["75e26d66", "47520de1"]),
    ("sick-radar", "/cloud_radar_track", [315, 12], ["752125b7", "e2a633dc"]),
    ("sick-radar", "/cloud_radar_rawtarget", [500, 15], ["21202e9f", "d7217199"]),
];

/// Keeps the observations made of the messages of one topic.
struct Kept {
    converter: Converter,
    topic: usize,
    items: Vec<Result<Item, NotMade>>,
}

impl Sink for Kept {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.converter.topic(topic)
    }

    fn message(&mut self, message: RecordedMessage<'_>, _position: u64) -> Result<(), Stopped> {
        if self.converter.topic_index(message.topic) == Some(self.topic) {
            self.items.extend(self.converter.convert(message.topic, message.recorded_nanos, message.data));
        }
        Ok(())
    }
}

fn open(path: &Path) -> std::fs::File {
    std::fs::File::open(path).expect("a readable file")
}

fn surveyed(path: &Path) -> Arc<Surveyed> {
    let mut survey = Survey::default();
    read(kind(path).expect("a known kind"), open(path), &mut survey).expect("a recording");
    Arc::new(survey.finish())
}

fn items(path: &Path, surveyed: &Arc<Surveyed>, plan: Plan, topic: &str) -> Vec<Result<Item, NotMade>> {
    let topic = surveyed.topics.iter().position(|known| known.name == topic).expect("the topic");
    // The reference has one pose a scan, and takes scans with the same stamp.
    let options = ConvertOptions { at_header: true, clock: Clock::Recorder, ..ConvertOptions::default() };
    let converter = Converter::new(surveyed.clone(), Arc::new(plan), options);
    let mut kept = Kept { converter, topic, items: Vec::new() };
    read(kind(path).expect("a known kind"), open(path), &mut kept).expect("a recording");
    kept.items
}

/// The end points of the scans and clouds, in the fixed frame.
fn ends(made: &Made) -> Vec<Point3<f64>> {
    match made {
        Made::Scan(scan) => {
            let is_used = |range: &f64| range.is_finite();
            let ranges = scan.ranges_m.iter().map(|range| f64::from(*range)).enumerate();
            ranges
                .filter(|(_, range)| is_used(range))
                .map(|(ray, range)| {
                    let angle = scan.angle_min_rad + ray as f64 * scan.angle_increment_rad;
                    scan.pose * Point3::new(range * angle.cos(), range * angle.sin(), 0.0)
                })
                .collect()
        }
        Made::Cloud(cloud) => {
            cloud.points_m.iter().map(|point| cloud.pose * Point3::from(point.map(f64::from))).collect()
        }
        _ => Vec::new(),
    }
}

fn crc(cells: &BTreeSet<Vec<i32>>) -> String {
    let bytes: Vec<u8> = cells.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
    format!("{:08x}", crc32fast::hash(&bytes))
}

/// Checks each sensor and each fixed frame of a reference; returns how many there were.
fn check(bags: &Path, name: &str, file: &str) -> usize {
    let text = std::fs::read_to_string(bags.join("reference").join(format!("{name}.json"))).expect("a reference");
    let reference: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let path = bags.join(file);
    let surveyed = surveyed(&path);
    let mut checked = 0;
    for (topic, sensor) in reference["sensors"].as_object().expect("sensors") {
        for (frame, wanted) in sensor["fixed"].as_object().expect("frames") {
            let wishes = Wishes { frame: Some(frame.clone()), ..Wishes::default() };
            let lost: u64 =
                wanted["lost"].as_object().expect("counts").values().filter_map(|count| count.as_u64()).sum();
            let Ok(plan) = plan(&surveyed, &wishes) else {
                assert_eq!(Some(lost), sensor["messages"].as_u64(), "{name} {topic}: no frame {frame}");
                checked += 1;
                continue;
            };
            let items = items(&path, &surveyed, plan, topic);
            let not_placed = items.iter().filter(|item| matches!(item, Err(NotMade::NoTransform(_)))).count();
            assert_eq!(not_placed as u64, lost, "{name} {topic} in {frame}: without a transform");
            if lost == sensor["messages"].as_u64().unwrap_or(0) {
                checked += 1;
                continue;
            }
            let cells = &wanted["cells"];
            let of_reference = || {
                let checksum = |key: &str| cells[key].as_str().unwrap_or_default();
                let count = |key: &str| cells[key].as_u64().unwrap_or_default();
                (["points", "cells2"].map(count), ["crc2", "crc3"].map(checksum))
            };
            let other = WITHOUT_MARKERS.iter().find(|(bag, from, ..)| (*bag, *from) == (name, topic.as_str()));
            let (counts, checksums) = other.map_or_else(of_reference, |(.., counts, checksums)| (*counts, *checksums));
            let points: Vec<Point3<f64>> = items.iter().flatten().flat_map(|item| ends(&item.made)).collect();
            assert_eq!(points.len() as u64, counts[0], "{name} {topic} in {frame}: points");
            let cell = |along: f64| (along / CELL_M).floor() as i32;
            let flat: BTreeSet<Vec<i32>> = points.iter().map(|at| vec![cell(at.x), cell(at.y)]).collect();
            assert_eq!(flat.len() as u64, counts[1], "{name} {topic} in {frame}: cells");
            assert_eq!(crc(&flat), checksums[0], "{name} {topic} in {frame}");
            // Sensors at a height that is the face of a cell differ in z with the rounding.
            if cells["near"][1].as_u64().is_some_and(|near| near < 100) {
                let solid: BTreeSet<Vec<i32>> =
                    points.iter().map(|at| vec![cell(at.x), cell(at.y), cell(at.z)]).collect();
                assert_eq!(crc(&solid), checksums[1], "{name} {topic} in {frame}");
            }
            checked += 1;
        }
    }
    checked
}

#[test]
fn scans_and_clouds_end_in_the_cells_of_their_references() {
    let Some(bags) = beside::recordings("bags") else { return };
    for (name, file, count) in [
        ("jarvis", "jarvis.bag", 4),
        ("jarvis_zstd", "jarvis_zstd/jarvis_zstd.mcap", 4),
        ("jarvis-cut-bag", "jarvis-cut.bag", 4),
        ("jarvis-cut-mcap", "jarvis-cut.mcap", 4),
        ("guardian-tilt", "guardian-tilt.bag", 2),
        ("guardian-cloud-lz4", "guardian-cloud-lz4.mcap", 1),
        ("sick-radar", "sick-radar.bag", 4),
        ("hokuyo-old-index", "hokuyo-old-index.bag", 1),
    ] {
        assert_eq!(check(&bags, name, file), count, "{name}");
    }
}

#[test]
fn scans_of_folders_end_in_the_cells_of_their_references() {
    let Some(bags) = beside::recordings("bags") else { return };
    for (name, count) in [("mumble", 2), ("turtlebot3", 1)] {
        let file = database(&bags, name);
        assert_eq!(check(&bags, name, &file), count, "{name}");
    }
}

fn database(bags: &Path, name: &str) -> String {
    let folder = std::fs::read_dir(bags.join(name)).expect("a folder");
    let files = folder.filter_map(|entry| entry.expect("an entry").file_name().into_string().ok());
    let is_recording = |file: &String| file.ends_with(".db3") || file.ends_with(".mcap");
    format!("{name}/{}", files.into_iter().find(is_recording).expect("a recording"))
}

#[test]
fn poses_are_where_their_references_have_them() {
    let Some(bags) = beside::recordings("bags") else { return };
    let mut checked = 0;
    for (name, file) in [
        ("jarvis", "jarvis.bag".to_owned()),
        ("guardian-tilt", "guardian-tilt.bag".to_owned()),
        ("turtlebot3", database(&bags, "turtlebot3")),
        ("crazyflie", database(&bags, "crazyflie")),
        ("crazyflie-nan", database(&bags, "crazyflie-nan")),
        ("zeros", "zeros.bag".to_owned()),
    ] {
        let text = std::fs::read_to_string(bags.join("reference").join(format!("{name}.json"))).expect("a reference");
        let reference: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let path = bags.join(file);
        let surveyed = surveyed(&path);
        for (topic, wanted) in reference["poses"].as_object().expect("poses") {
            let known = surveyed.topics.iter().find(|known| known.name == *topic).expect("the topic");
            let field = match known.type_name.as_str() {
                "nav_msgs/Odometry" => "pose.pose",
                "geometry_msgs/Pose" => "position",
                _ => "pose",
            };
            let text = format!("positions: {{'{topic}.{field}': {{state: robot, dimensions: 3}}}}");
            let mapping = Mapping::read(&text).expect("a mapping");
            let frame = Some(known.frame.clone()).filter(|frame| !frame.is_empty());
            let plan = plan(&surveyed, &Wishes { mapping, frame, ..Wishes::default() }).expect("a plan");
            let items = items(&path, &surveyed, plan, topic);
            assert_eq!(Some(items.len() as u64), wanted["n"].as_u64(), "{name} {topic}: messages");
            let at: Vec<Vector3<f64>> = items.iter().flatten().filter_map(|item| position(&item.made)).collect();
            assert_eq!(Some(at.len() as u64), wanted["finite"].as_u64(), "{name} {topic}: finite");
            checked += 1;
            let (Some(first), Some(last)) = (at.first(), at.last()) else { continue };
            let length: f64 = at.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            assert!((length - wanted["length"].as_f64().unwrap_or(f64::NAN)).abs() < 1e-6, "{name} {topic}: {length}");
            for (found, wanted) in [(first, &wanted["first"]), (last, &wanted["last"])] {
                let wanted = Vector3::from_fn(|axis, _| wanted[axis + 1].as_f64().unwrap_or(f64::NAN));
                assert!((found - wanted).norm() < 1e-9, "{name} {topic}: {found} is not {wanted}");
            }
        }
    }
    assert_eq!(checked, 12);
}

fn position(made: &Made) -> Option<Vector3<f64>> {
    let Made::Position { coordinates_m, .. } = made else { return None };
    Some(Vector3::from_column_slice(coordinates_m))
}

#[test]
fn a_grid_whose_cells_have_no_size_is_refused_with_the_reason() {
    let Some(bags) = beside::recordings("bags") else { return };
    let path = bags.join("zeros.bag");
    let surveyed = surveyed(&path);
    let plan = plan(&surveyed, &Wishes::default()).expect("a plan");
    let items = items(&path, &surveyed, plan, "/occupancygrid");
    let refusals: Vec<String> = items.into_iter().filter_map(|item| item.err().map(|why| why.to_string())).collect();
    assert_eq!(refusals, ["a grid with cells of 0 m: the resolution must be above 0"]);
}
