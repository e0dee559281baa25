//! The contents of a recording: its topics, the number and times of the messages of each, and the frames.
//!
//! Invariant: connections of one topic and type count together. Messages that cannot be read are counted, with the
//! first reason; none ends the survey.

mod clock;
mod poses;

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    sync::Arc,
};

use crate::{
    definition::Constant,
    foreign::Translator,
    frames::{Frames, TransformError, frame_name},
    known::{self, Grid},
    layout::{self, Structure},
    message::{self, Value},
    recording::{Encoding, RecordedMessage, RecordingError, Sink, Stopped, Topic},
};

use self::{clock::RobotClock, poses::Poses};
pub use self::{
    clock::TakenPart,
    poses::{PoseSource, TakenPoses},
};

/// Types whose messages are transforms.
const TRANSFORM_TYPES: [&str; 2] = ["tf2_msgs/TFMessage", "tf/tfMessage"];
/// Types of Foxglove whose messages are transforms.
const FOXGLOVE_TRANSFORMS: [&str; 2] = ["FrameTransform", "FrameTransforms"];

/// First and last of some times, nanoseconds since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeSpan {
    /// The earliest.
    pub first_nanos: i64,
    /// The latest.
    pub last_nanos: i64,
}

impl TimeSpan {
    fn extend(span: &mut Option<Self>, time_nanos: i64) {
        *span = Some(match *span {
            None => Self { first_nanos: time_nanos, last_nanos: time_nanos },
            Some(Self { first_nanos, last_nanos }) => {
                Self { first_nanos: first_nanos.min(time_nanos), last_nanos: last_nanos.max(time_nanos) }
            }
        });
    }
}

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicSurvey {
    /// Name of the topic.
    pub name: String,
    /// The type of the messages, without the folder of ROS 2.
    pub type_name: String,
    /// Number of messages.
    pub messages: u64,
    /// The times of recording of the messages.
    pub recorded: Option<TimeSpan>,
    /// The times for which they hold, if they have such times.
    pub stamps: Option<TimeSpan>,
    /// Frame of the first message that names one, without a leading slash.
    pub frame: String,
    /// Number of messages that cannot be read.
    pub unread: u64,
    /// Why the first message cannot be read.
    pub problem: Option<String>,
    /// The fields of the messages, unless the definition cannot be read.
    pub layout: Option<Arc<Structure>>,
    /// For a topic of occupancy grids: the edge of a cell of the first grid, metres, and where its first cell begins in
    /// its frame.
    pub grid: Option<(f64, [f64; 2])>,
}

impl TopicSurvey {
    /// The constants of the type that a field is of, such as the names of the modes of a door.
    pub fn constants(&self) -> &[Constant] {
        self.layout.as_ref().map_or(&[], |layout| &layout.constants)
    }
}

/// The reader of the messages of a topic.
#[derive(Clone, Debug)]
pub(crate) struct TopicReader {
    /// Index of the topic among the topics of the survey.
    pub(crate) topic: usize,
    pub(crate) layout: Result<Arc<Structure>, String>,
    pub(crate) encoding: Encoding,
    translator: Option<Translator>,
}

impl TopicReader {
    /// Reads a message; `buffer` takes its bytes if they have to be brought into another layout.
    pub(crate) fn read<'a>(&self, data: &'a [u8], buffer: &'a mut Vec<u8>) -> Result<Value<'a>, String> {
        let layout = self.layout.as_ref().map_err(String::clone)?;
        let Some(translator) = &self.translator else {
            return message::read(layout, &self.encoding, data).map_err(|error| error.to_string());
        };
        translator.translate(data, buffer)?;
        message::read(layout, &Encoding::Ros1, buffer).map_err(|error| error.to_string())
    }
}

/// Indices of topics by name and type.
#[derive(Clone, Debug, Default)]
pub(crate) struct TopicTable(HashMap<(String, String), usize>);

impl TopicTable {
    /// The index of a topic, and whether it is new.
    pub(crate) fn index(&mut self, topic: &Topic) -> (usize, bool) {
        let count = self.0.len();
        let index = *self.0.entry((topic.name.clone(), topic.type_name.clone())).or_insert(count);
        (index, index == count)
    }
}

pub(crate) fn connection(topic: &Topic, index: usize) -> TopicReader {
    let Topic { type_name, encoding, definition, .. } = topic;
    let (layout, translator) = match (Translator::of_topic(type_name, encoding), encoding) {
        (Some(Ok(translator)), _) => (Ok(translator.layout()), Some(translator)),
        (Some(Err(why)), _) => (Err(why), None),
        (None, Encoding::Unreadable(why)) => (Err(why.clone()), None),
        (None, Encoding::Other(name)) => {
            let why = format!("its messages are in the encoding {name:?}; CDR, ROS 1, JSON and protobuf are read");
            (Err(why), None)
        }
        (None, _) => (layout::of_type(type_name, definition, encoding).map_err(|error| error.to_string()), None),
    };
    TopicReader { topic: index, layout, encoding: encoding.clone(), translator }
}

/// Surveys a recording: give it to a reader as the sink, for each file of the recording after [`Survey::next_file`].
#[derive(Debug, Default)]
pub struct Survey {
    topics: Vec<TopicSurvey>,
    table: TopicTable,
    connections: Vec<TopicReader>,
    frames: Frames,
    /// Children whose transforms are kept; all if absent.
    kept: Option<HashSet<String>>,
    /// Whether there are more transforms than are kept.
    too_many: bool,
    parents: BTreeMap<String, String>,
    bad_transforms: u64,
    position: u64,
    watch: Option<ReadWatch>,
    /// Topics whose transforms are left out.
    skipped: Vec<String>,
    poses: Option<Poses>,
    clock: RobotClock,
    passed_over: u64,
    first_passed_over: Option<String>,
}

/// Receives the number of bytes that have been read.
struct ReadWatch(Box<dyn FnMut(u64)>);

impl std::fmt::Debug for ReadWatch {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        to.write_str("ReadWatch")
    }
}

impl Survey {
    /// Leaves out the transforms of some topics.
    pub fn without_transforms_of(topics: &[String]) -> Self {
        Self { skipped: topics.to_vec(), ..Self::default() }
    }

    /// Takes the poses of a topic in place of the transforms of the frame that has them.
    pub fn take_poses(&mut self, source: PoseSource) {
        self.poses = Some(Poses::new(source));
    }

    /// Watches how many bytes of the current file have been read.
    pub fn watch(&mut self, watch: impl FnMut(u64) + 'static) {
        self.watch = Some(ReadWatch(Box::new(watch)));
    }

    /// Begins the next file of the recording.
    pub fn next_file(&mut self) {
        self.connections.clear();
    }

    /// Begins again with the first file, and keeps only the transforms between frames of sensors and their roots: for
    /// recordings with more transforms than can be kept. `requested`: the frame in which everything is to be placed.
    pub fn again_with_sensors(&mut self, requested: Option<&str>) {
        let mut kept = HashSet::new();
        let usual = ["map", "odom"].into_iter().chain(requested.map(frame_name));
        for mut frame in self.topics.iter().map(|topic| topic.frame.as_str()).chain(usual) {
            while let Some(parent) = self.parents.get(frame) {
                if !kept.insert(frame.to_owned()) {
                    break;
                }
                frame = parent;
            }
        }
        *self = Self {
            kept: Some(kept),
            parents: std::mem::take(&mut self.parents),
            watch: self.watch.take(),
            skipped: std::mem::take(&mut self.skipped),
            poses: self.poses.take().map(|poses| Poses::new(poses.source)),
            ..Self::default()
        };
    }

    /// Number of messages so far.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.messages).sum()
    }

    /// Whether the recording has more transforms than can be kept, so that some are missing.
    pub fn has_too_many_transforms(&self) -> bool {
        self.too_many
    }

    /// Returns the contents: call it once after the last file.
    pub fn finish(mut self) -> Surveyed {
        let is_sensor = |topic: &&TopicSurvey| known::is_scan(&topic.type_name) || known::is_cloud(&topic.type_name);
        let sensor = self.topics.iter().filter(is_sensor).map(|topic| topic.frame.as_str());
        let sensor = sensor.clone().find(|frame| !frame.is_empty()).unwrap_or_default();
        self.too_many |= self.poses.as_ref().is_some_and(|poses| poses.has_too_many);
        let part = self.clock.finish(&mut self.frames);
        let is_taken = |recorded_nanos| part.is_none_or(|part| part.contains(recorded_nanos));
        let poses = self.poses.take().map(|poses| poses.put_into(&mut self.frames, sensor, is_taken));
        self.frames.finish();
        Surveyed {
            part,
            topics: self.topics,
            frames: self.frames,
            poses,
            bad_transforms: self.bad_transforms,
            has_too_many_transforms: self.too_many,
            passed_over: self.first_passed_over.map(|first| (self.passed_over, first)),
        }
    }

    fn transforms(
        &mut self,
        message: &Value<'_>,
        recorded_nanos: i64,
        is_static: bool,
        lasts: bool,
    ) -> Result<(), String> {
        for transform in known::transforms(message).map_err(|error| error.to_string())? {
            let Ok(mut transform) = transform else {
                self.bad_transforms += 1;
                continue;
            };
            if transform.time_nanos == 0 {
                transform.time_nanos = recorded_nanos;
            }
            if !is_static && !lasts {
                let source = [&transform.child, "\n", &transform.parent].concat();
                self.clock.stamped(&source, transform.time_nanos, recorded_nanos, &mut self.frames);
            }
            if self.parents.len() < crate::recording::TOPICS_MAX {
                self.parents.insert(transform.child.clone(), transform.parent.clone());
            }
            if self.kept.as_ref().is_some_and(|kept| !is_static && !kept.contains(&transform.child)) {
                continue;
            }
            if lasts {
                self.frames.last(&transform.child);
            }
            if self.frames.add(transform, is_static) == Err(TransformError::TooMany) {
                self.too_many = true;
            }
        }
        Ok(())
    }
}

/// The contents of a recording.
#[derive(Debug, Default)]
pub struct Surveyed {
    /// The topics, in the order in which they were found.
    pub topics: Vec<TopicSurvey>,
    /// The tree of its frames.
    pub frames: Frames,
    /// The part that is taken, if the robot's clock went back.
    pub part: Option<TakenPart>,
    /// The poses that were taken in place of transforms.
    pub poses: Option<TakenPoses>,
    /// Number of transforms that are none: not finite, or without names.
    pub bad_transforms: u64,
    /// Whether the recording has more transforms than can be kept, so that some are missing.
    pub has_too_many_transforms: bool,
    /// Number of messages and blocks that are too long to be read, and the message about the first.
    pub passed_over: Option<(u64, String)>,
}

/// Whether the messages of a type are transforms.
pub fn is_transforms(type_name: &str) -> bool {
    TRANSFORM_TYPES.contains(&type_name) || is_foxglove_transforms(type_name)
}

fn is_foxglove_transforms(type_name: &str) -> bool {
    known::foxglove_type(type_name).is_some_and(|name| FOXGLOVE_TRANSFORMS.contains(&name))
}

impl Sink for Survey {
    fn topic(&mut self, topic: &Topic) -> bool {
        let (index, is_new) = self.table.index(topic);
        let connection = connection(topic, index);
        if is_new {
            self.topics.push(TopicSurvey {
                name: topic.name.clone(),
                type_name: topic.type_name.clone(),
                messages: 0,
                recorded: None,
                stamps: None,
                frame: String::new(),
                unread: 0,
                problem: None,
                layout: connection.layout.clone().ok(),
                grid: None,
            });
        }
        self.connections.push(connection);
        true
    }

    fn passed_over(&mut self, why: &RecordingError) {
        self.passed_over += 1;
        self.first_passed_over.get_or_insert_with(|| why.to_string());
    }

    fn message(&mut self, message: RecordedMessage<'_>, position: u64) -> Result<(), Stopped> {
        if let Some(ReadWatch(watch)) = &mut self.watch
            && position != self.position
        {
            self.position = position;
            watch(position);
        }
        let Some(connection) = self.connections.get(message.topic) else { return Ok(()) };
        let index = connection.topic;
        let mut buffer = Vec::new();
        let read = connection.read(message.data, &mut buffer);
        let Some(topic) = self.topics.get_mut(index) else { return Ok(()) };
        topic.messages += 1;
        TimeSpan::extend(&mut topic.recorded, message.recorded_nanos);
        let problem = match read {
            Ok(value) => {
                if topic.grid.is_none() && topic.type_name == "nav_msgs/OccupancyGrid" {
                    topic.grid = Grid::read(&value).ok().map(|grid| {
                        let at = grid.origin.translation.vector;
                        (grid.resolution_m, [at.x, at.y])
                    });
                }
                // A stamp of 0 was not set.
                if let Some(stamp) = known::stamp(&value).filter(|stamp| *stamp != 0) {
                    TimeSpan::extend(&mut topic.stamps, stamp);
                }
                if topic.frame.is_empty() {
                    topic.frame = known::frame(&value);
                }
                if let Some(stamp) = known::stamp(&value).filter(|stamp| *stamp != 0)
                    && (known::is_scan(&topic.type_name) || known::is_cloud(&topic.type_name))
                {
                    // Scanners of one topic may have different clocks.
                    let source = [&topic.name, "\n\n", &known::frame(&value)].concat();
                    self.clock.stamped(&source, stamp, message.recorded_nanos, &mut self.frames);
                }
                if let Some(poses) = self.poses.as_mut().filter(|poses| poses.source.topic == topic.name) {
                    poses.add(&topic.type_name, &value, message.recorded_nanos);
                }
                if is_transforms(&topic.type_name) && !self.skipped.contains(&topic.name) {
                    let is_static = frame_name(&topic.name).ends_with("tf_static");
                    let lasts = is_foxglove_transforms(&topic.type_name);
                    self.transforms(&value, message.recorded_nanos, is_static, lasts).err()
                } else {
                    None
                }
            }
            Err(problem) => Some(problem),
        };
        if let (Some(problem), Some(topic)) = (problem, self.topics.get_mut(index)) {
            topic.unread += 1;
            topic.problem.get_or_insert(problem);
        }
        Ok(())
    }
}
