//! Recordings in JSON and protobuf with the types of Foxglove, as `foxglove.py` has written them.
//!
//! Invariant: what is expected follows from that program.

use std::{path::PathBuf, sync::Arc};

use nalgebra::Point3;
use tidemap_recordings::{
    convert::{ConvertOptions, Converter, Item, Made, NotMade},
    kind::read,
    mapping::Mapping,
    plan::{Plan, PlanError, Wishes, plan},
    recording::{RecordedMessage, Sink, Stopped, Topic},
    survey::{PoseSource, Survey, Surveyed},
};

use super::kind;

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/reference").join(name)
}

fn surveyed(name: &str) -> Arc<Surveyed> {
    let mut survey = Survey::default();
    let file = std::fs::File::open(path(name)).expect("a readable file");
    read(kind(&path(name)).expect("a known kind"), file, &mut survey).expect("a recording");
    Arc::new(survey.finish())
}

/// The observations of each message with its topic.
struct Kept(Converter, Vec<(usize, Result<Item, NotMade>)>);

impl Sink for Kept {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.0.topic(topic)
    }

    fn message(&mut self, message: RecordedMessage<'_>, _position: u64) -> Result<(), Stopped> {
        let topic = self.0.topic_index(message.topic).expect("its topic came before");
        let made = self.0.convert(message.topic, message.recorded_nanos, message.data);
        self.1.extend(made.into_iter().map(|made| (topic, made)));
        Ok(())
    }
}

fn converted(name: &str, surveyed: &Arc<Surveyed>, plan: Plan) -> Vec<(String, Result<Item, NotMade>)> {
    let mut kept = Kept(Converter::new(surveyed.clone(), Arc::new(plan), ConvertOptions::default()), Vec::new());
    let file = std::fs::File::open(path(name)).expect("a readable file");
    read(kind(&path(name)).expect("a known kind"), file, &mut kept).expect("a recording");
    kept.1.into_iter().map(|(topic, made)| (surveyed.topics[topic].name.clone(), made)).collect()
}

fn becomes(surveyed: &Surveyed, plan: &Plan) -> Vec<(String, String)> {
    let topics = surveyed.topics.iter().zip(&plan.topics);
    topics.map(|(topic, plan)| (topic.name.clone(), plan.skipped.clone().unwrap_or_else(|| plan.becomes()))).collect()
}

fn check_places(items: &[(String, Result<Item, NotMade>)]) {
    let made = |topic: &str| &items.iter().find(|(name, _)| name == topic).expect("the topic").1;
    let Ok(Item { made: Made::Scan(scan), time_nanos }) = made("/scan") else { panic!("{:?}", made("/scan")) };
    assert_eq!(*time_nanos, 1_700_000_000_500_000_000);
    assert_eq!(scan.ranges_m, [1.0, 2.0, f32::INFINITY]);
    let right = scan.pose * (Point3::new(scan.angle_min_rad.cos(), scan.angle_min_rad.sin(), 0.0));
    assert!((right - Point3::new(2.0, -1.0, 0.0)).norm() < 1e-9, "{right}");
    assert!((scan.angle_increment_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    let Ok(Item { made: Made::Cloud(cloud), .. }) = made("/points") else { panic!("{:?}", made("/points")) };
    let ends: Vec<Point3<f64>> =
        cloud.points_m.iter().map(|point| cloud.pose * Point3::from(point.map(f64::from))).collect();
    assert_eq!(ends, [Point3::new(3.5, 0.0, 1.5), Point3::new(1.5, -1.0, 1.5)]);
}

#[test]
fn protobuf_is_read_by_the_schemas_in_the_file() {
    let name = "foxglove-protobuf.mcap";
    let surveyed = surveyed(name);
    let mapping =
        Mapping::read("states: {/log.level: {state: 'level-{name}', values: {4: 1, 3: 0}}}").expect("a mapping");
    let plan = plan(&surveyed, &Wishes { mapping, ..Wishes::default() }).expect("a plan");
    let is = |topic: &str, becomes: &str| (topic.to_owned(), becomes.to_owned());
    assert_eq!(
        becomes(&surveyed, &plan),
        [
            is("/mounts", "frames"),
            is("/place", "frames"),
            is("/scan", "scans"),
            is("/points", "clouds"),
            is("/pose", "positions pose"),
            is("/fix", "nothing is made of foxglove.LocationFix without a mapping"),
            is("/log", "state level-{name}"),
        ]
    );
    let items = converted(name, &surveyed, plan);
    check_places(&items);
    let made = |topic: &str| {
        let (_, item) = items.iter().find(|(name, _)| name == topic).expect("the topic");
        item.as_ref().expect("an observation").made.clone()
    };
    assert_eq!(made("/pose"), Made::Position { state: "pose".to_owned(), coordinates_m: vec![1.5, 0.0] });
    assert_eq!(made("/log"), Made::Value { state: "level-door".to_owned(), value: 1.0, rule: 0 });
    let constants = surveyed.topics.last().expect("a topic").constants();
    assert!(constants.iter().any(|constant| constant.name == "ERROR" && constant.value == "4"), "{constants:?}");
}

#[test]
fn json_is_read_by_the_schemas_in_the_file_and_what_is_not_read_has_its_reason() {
    let name = "foxglove-json.mcap";
    let surveyed = surveyed(name);
    let mapping = Mapping::read("states: {/door.open: door, '/door.grid[1].elements': {state: row, kind: count}}");
    let plan = plan(&surveyed, &Wishes { mapping: mapping.expect("a mapping"), ..Wishes::default() }).expect("a plan");
    let reasons = becomes(&surveyed, &plan);
    let reason = |topic: &str| reasons.iter().find(|(name, _)| name == topic).expect("the topic").1.as_str();
    assert_eq!(reason("/scan"), "scans");
    assert_eq!(reason("/bare"), "its channel has no schema, so the fields of its messages are not known");
    assert_eq!(
        reason("/flat"),
        "its messages are in the encoding \"flatbuffer\"; CDR, ROS 1, JSON and protobuf are read"
    );
    let items = converted(name, &surveyed, plan);
    check_places(&items);
    let door: Vec<_> = items.iter().filter(|(name, _)| name == "/door").map(|(_, item)| item).collect();
    let values: Vec<f64> = door
        .iter()
        .filter_map(|item| match &item.as_ref().ok()?.made {
            Made::Value { value, .. } => Some(*value),
            _ => None,
        })
        .collect();
    assert_eq!(values, [1.0, 1.0], "the door is open; its second row has one element");
    assert_eq!(door[2], &Err(NotMade::Wrong("open: \"ajar\" is not true or false".to_owned())));
}

#[test]
fn poses_of_foxglove_take_the_place_of_transforms() {
    let mut survey = Survey::default();
    survey.take_poses(PoseSource::read("/pose=base"));
    let name = "foxglove-protobuf.mcap";
    let file = std::fs::File::open(path(name)).expect("a readable file");
    read(kind(&path(name)).expect("a known kind"), file, &mut survey).expect("a recording");
    let surveyed = survey.finish();
    assert_eq!(surveyed.poses.as_ref().map(|poses| poses.taken), Some(1));
    let wishes = |topic: &str| Wishes { pose_from: Some(PoseSource::read(topic)), ..Wishes::default() };
    assert!(plan(&surveyed, &wishes("/pose=base")).is_ok());
    assert!(matches!(plan(&surveyed, &wishes("/fix")), Err(PlanError::NoPoses { .. })));
}
