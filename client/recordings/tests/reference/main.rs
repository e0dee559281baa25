//! Compares recordings of real robots with the output of other programs: topics, counts, first and last times.
//!
//! Invariant: the recordings lie beside the repository; without them the tests are skipped and print a message.

use std::{collections::BTreeMap, fs::File, path::Path};

use serde_json::Value;
use tidemap_recordings::{
    folder::{Folder, METADATA_NAME},
    kind::{DETECT_BYTES, read},
    recording::{Ending, FileKind, RecordedMessage, RecordingError, Sink, Stopped, Topic},
};

#[path = "../../../../server/model/tests/recordings/folder.rs"]
mod beside;
mod cells;
mod foxglove;

/// Type, number of messages, first and last time of recording.
type Found = (String, u64, Option<(i64, i64)>);

#[derive(Default)]
struct Counts {
    names: Vec<String>,
    topics: BTreeMap<String, Found>,
}

impl Sink for Counts {
    fn topic(&mut self, topic: &Topic) -> bool {
        self.names.push(topic.name.clone());
        self.topics.entry(topic.name.clone()).or_insert_with(|| (topic.type_name.clone(), 0, None));
        true
    }

    fn message(&mut self, message: RecordedMessage<'_>, _position: u64) -> Result<(), Stopped> {
        let found = self.topics.get_mut(&self.names[message.topic]).expect("its topic came before");
        let time = message.recorded_nanos;
        let (first, last) = found.2.unwrap_or((time, time));
        (found.1, found.2) = (found.1 + 1, Some((first.min(time), last.max(time))));
        Ok(())
    }
}

fn kind(path: &Path) -> Result<FileKind, RecordingError> {
    let bytes = std::fs::read(path).expect("a readable file");
    FileKind::detect(&bytes[..bytes.len().min(DETECT_BYTES)])
}

fn counted(path: &Path) -> (Counts, Ending) {
    let mut counts = Counts::default();
    let source = File::open(path).expect("a readable file");
    let ending = kind(path).and_then(|kind| read(kind, source, &mut counts));
    (counts, ending.unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

/// The topics of a recording in the reference; topics without messages are left out.
fn reference(bags: &Path, name: &str) -> BTreeMap<String, Found> {
    let text = std::fs::read_to_string(bags.join("reference").join(format!("{name}.json"))).expect("a reference");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let topic = |topic: &Value| {
        let count = topic["count"].as_u64().expect("a count");
        let type_name = topic["type"].as_str().expect("a type").replace("/msg/", "/");
        let times = topic["log"][0].as_i64().zip(topic["log"][1].as_i64());
        (count > 0).then(|| (topic["topic"].as_str().expect("a name").to_owned(), (type_name, count, times)))
    };
    value["topics"].as_array().expect("topics").iter().filter_map(topic).collect()
}

fn check(bags: &Path, name: &str, file: &str) -> Ending {
    let (mut counts, ending) = counted(&bags.join(file));
    counts.topics.retain(|_, found| found.1 > 0);
    let wanted = reference(bags, name);
    assert!(!wanted.is_empty(), "{name}: the reference has topics");
    assert_eq!(counts.topics, wanted, "{name}");
    ending
}

#[test]
fn whole_recordings_have_the_messages_of_their_references() {
    let Some(bags) = beside::recordings("bags") else { return };
    for name in ["jarvis", "guardian-tilt", "sick-radar", "hokuyo-old-index", "turtlesim-lz4", "zeros"] {
        assert_eq!(check(&bags, name, &format!("{name}.bag")), Ending::Whole, "{name}");
    }
    assert_eq!(check(&bags, "guardian-cloud-lz4", "guardian-cloud-lz4.mcap"), Ending::Whole);
}

#[test]
fn folders_of_rosbag2_have_the_messages_of_their_references() {
    let Some(bags) = beside::recordings("bags") else { return };
    for name in ["mumble", "turtlebot3", "crazyflie", "crazyflie-nan", "jarvis_zstd"] {
        let text = std::fs::read_to_string(bags.join(name).join(METADATA_NAME)).expect("a readable file");
        let folder = Folder::parse(&text).expect("metadata of rosbag2");
        let [file] = &folder.files[..] else { panic!("{name}: {:?}", folder.files) };
        assert_eq!(check(&bags, name, &format!("{name}/{file}")), Ending::Whole, "{name}");
    }
}

#[test]
fn recordings_that_are_cut_off_have_their_complete_chunks() {
    let Some(bags) = beside::recordings("bags") else { return };
    for (name, file, bytes) in
        [("jarvis-cut-bag", "jarvis-cut.bag", "700000"), ("jarvis-cut-mcap", "jarvis-cut.mcap", "1000000")]
    {
        let ending = check(&bags, name, file);
        assert!(matches!(&ending, Ending::CutOff(text) if text.contains(bytes)), "{name}: {ending:?}");
    }
}

#[test]
fn a_bag_of_an_old_version_is_refused_by_its_name() {
    let Some(bags) = beside::recordings("bags") else { return };
    let error = kind(&bags.join("rosrecord-1.2.bag")).expect_err("an old version").to_string();
    assert!(error.contains("ROSRECORD V1.2"), "{error}");
}
