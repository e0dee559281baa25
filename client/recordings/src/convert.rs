//! From messages to observations, by a plan.
//!
//! Invariant: the same recording and plan make the same observations in the same order, whatever the speed. A message
//! becomes observations, or it is counted with the reason why not.

mod beams;
mod merged;
mod motion;
mod sensors;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use nalgebra::Isometry3;

pub use self::{beams::BeamCounts, merged::CellSize};

use crate::{
    frames::{FrameError, frame_name},
    known::{self, Cloud, Grid, GridUpdate, KnownError},
    mapping::{PositionRule, StateRule, TraversalRule, ValueKind, ValueRule, shown},
    message::Value,
    plan::{GridUse, Plan, TopicPlan},
    recording::Topic,
    survey::{Surveyed, TopicReader, TopicTable, connection},
};

/// One cloud of a topic and frame is taken in this time by default, if the clouds have many points. Cells are learned
/// from half-hour bins: more clouds cost time and change hardly anything. Clouds of few points can be parts of a turn
/// of the scanner, and all are taken.
pub const CLOUD_PERIOD_NANOS: i64 = 1_000_000_000;
/// Clouds of this number of points or more have many.
pub const CLOUD_POINTS_MANY: usize = 20_000;

/// Maximum number of characters of a value in a message.
const SHOWN_CHARS: usize = 80;

/// The number of stamps that are kept of a topic and frame: messages with the same stamp follow each other closely.
const LAST_STAMPS: usize = 16;

/// The clock that gives the times of observations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// The clock of the robot, which stamps messages; the recorder's clock for messages without a stamp.
    #[default]
    Stamps,
    /// The clock of the recorder.
    Recorder,
}

/// A scan of a planar range finder in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedScan {
    /// Pose of the sensor.
    pub pose: Isometry3<f64>,
    /// Angle of the first ray from the x axis of the sensor, radians.
    pub angle_min_rad: f64,
    /// Angle between rays, radians.
    pub angle_increment_rad: f64,
    /// Smallest valid range, metres.
    pub range_min_m: f64,
    /// Largest valid range, metres.
    pub range_max_m: f64,
    /// Valid ranges, metres; infinity: no return; NaN: no reading.
    pub ranges_m: Vec<f32>,
}

/// A point cloud in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedCloud {
    /// Pose of the sensor.
    pub pose: Isometry3<f64>,
    /// Points where beams have ended, in the frame of the sensor, metres.
    pub points_m: Vec<[f32; 3]>,
    /// Number of these points before points of one cell were merged.
    pub points_before: usize,
}

/// An occupancy grid in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedGrid {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Pose of the lower left corner of the first cell.
    pub origin: Isometry3<f64>,
    /// Occupancy in percent, row by row from the bottom; -1: unknown.
    pub percents: Vec<i8>,
}

/// The data that is made of one message.
#[derive(Clone, Debug, PartialEq)]
pub enum Made {
    /// A scan.
    Scan(PlacedScan),
    /// A point cloud.
    Cloud(PlacedCloud),
    /// A grid.
    Grid(PlacedGrid),
    /// A value of a state; the rule is numbered among the rules of the topic.
    Value {
        /// Name of the state.
        state: String,
        /// The value.
        value: f64,
        /// Index of the rule.
        rule: usize,
    },
    /// A label of a categorical state.
    Label {
        /// Name of the state.
        state: String,
        /// The label.
        label: String,
        /// Index of the rule.
        rule: usize,
    },
    /// A position of a vector, metres.
    Position {
        /// Name of the vector.
        state: String,
        /// The coordinates, two or three.
        coordinates_m: Vec<f64>,
    },
    /// A traversal of an edge.
    Traversal {
        /// The node where the edge begins.
        from: String,
        /// The node where it ends.
        to: String,
        /// The start of the traversal, nanoseconds since 1970; it ended at the time of the observation.
        start_nanos: i64,
        /// Whether the robot arrived.
        success: bool,
        /// The reason of the end, if the robot did not arrive.
        reason: String,
    },
}

/// An observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// The time, nanoseconds since 1970.
    pub time_nanos: i64,
    /// The data of the observation.
    pub made: Made,
}

/// Why nothing was made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotMade {
    /// The pose of its frame is not known.
    #[error("{0}")]
    NoTransform(#[from] FrameError),
    /// No frame was chosen: no transforms give the position of the robot.
    #[error("nothing in the recording gives the position of {0:?}")]
    NoFrame(String),
    /// Another scan of the topic was taken shortly before.
    #[error("left out, because one shortly before is taken; --period 0s takes all")]
    Thinned,
    /// The robot's clock went back, and another part of the recording is taken.
    #[error(
        "left out, because the robot's clock went back before or after it, and another part of the recording is taken"
    )]
    OtherPart,
    /// Another scan or cloud of its topic and frame has the same stamp.
    #[error(
        "left out, because another message of its topic and frame has the same stamp; --times recorder takes each at \
         its time of recording"
    )]
    SameStamp,
    /// An equal scan or cloud of the topic came before.
    #[error("left out, because the same message came before")]
    Repeated,
    /// The value maps to no value of the state.
    #[error("the value {0:?} means no value of the state")]
    LeftOut(String),
    /// The sensor has seen nothing, or the grid has no known cells.
    #[error("{0}")]
    Nothing(&'static str),
    /// The rays of a cloud in a frame that does not move have no known beginning.
    #[error(
        "its points are in {0:?} already, so the sensor's place is unknown; --frame {0} takes it as the sensor's place"
    )]
    NoSensor(String),
    /// Values of the message are wrong.
    #[error("{0}")]
    Wrong(String),
}

impl From<KnownError> for NotMade {
    fn from(error: KnownError) -> Self {
        Self::Wrong(error.to_string())
    }
}

/// The options of the conversion of messages to observations, apart from the plan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConvertOptions {
    /// The clock that gives the times.
    pub clock: Clock,
    /// The points of a cloud that end in the same of these cells are merged: the first is taken; all if absent.
    pub merge: Option<CellSize>,
    /// One of the scans, clouds or grids of a topic and frame is taken in each period of this length, nanoseconds; all
    /// if 0. Absent: 0, but [`CLOUD_PERIOD_NANOS`] for clouds of at least [`CLOUD_POINTS_MANY`] points.
    pub period_nanos: Option<i64>,
    /// Whether all beams of a scan or cloud are placed at the time of its header, not each at its own.
    pub at_header: bool,
}

/// Makes observations of messages.
#[derive(Debug)]
pub struct Converter {
    surveyed: Arc<Surveyed>,
    plan: Arc<Plan>,
    options: ConvertOptions,
    /// The period in which the last scan, cloud or grid of each topic and frame was taken.
    taken: BTreeMap<(usize, String), i64>,
    table: TopicTable,
    connections: Vec<TopicReader>,
    /// The last grid of each topic of grids whose changes are taken.
    grids: BTreeMap<usize, (PlacedGrid, String)>,
    /// The last stamps of each topic and frame of scans or clouds, with checksums of the messages.
    stamps: BTreeMap<(usize, String), VecDeque<(i64, u32)>>,
    /// The beams of the placed scans and clouds of each topic.
    beams: BTreeMap<usize, BeamCounts>,
}

impl Converter {
    /// Prepares to convert.
    pub fn new(surveyed: Arc<Surveyed>, plan: Arc<Plan>, options: ConvertOptions) -> Self {
        let (table, connections, grids, taken, stamps, beams) = Default::default();
        Self { surveyed, plan, options, taken, table, connections, grids, stamps, beams }
    }

    /// Begins the next file of the recording.
    pub fn next_file(&mut self) {
        self.connections.clear();
    }

    /// Takes a topic of the file, like [`crate::recording::Sink::topic`]. Returns whether its messages become
    /// observations.
    pub fn topic(&mut self, topic: &Topic) -> bool {
        let (index, _) = self.table.index(topic);
        self.connections.push(connection(topic, index));
        self.plan.topics.get(index).is_some_and(TopicPlan::is_observed)
    }

    /// Index of the topic of a connection of the file among the topics of the survey.
    pub fn topic_index(&self, of_file: usize) -> Option<usize> {
        self.connections.get(of_file).map(|connection| connection.topic)
    }

    /// The beams of the scans and clouds of each topic so far, those without a place left out.
    pub fn beams(&self) -> &BTreeMap<usize, BeamCounts> {
        &self.beams
    }

    /// Makes observations of a message.
    pub fn convert(&mut self, of_file: usize, recorded_nanos: i64, data: &[u8]) -> Vec<Result<Item, NotMade>> {
        let Some(connection) = self.connections.get(of_file) else { return Vec::new() };
        let index = connection.topic;
        let mut buffer = Vec::new();
        let message = match connection.read(data, &mut buffer) {
            Ok(message) => message,
            Err(problem) => return vec![Err(NotMade::Wrong(problem))],
        };
        let plans = self.plan.clone();
        let Some(plan) = plans.topics.get(index) else { return Vec::new() };
        let stamp = known::stamp(&message).filter(|stamp| *stamp != 0);
        // Without a stamp, the transforms at the time of recording are the best that there are.
        let stamp_nanos = stamp.unwrap_or(recorded_nanos);
        let time_nanos = if self.options.clock == Clock::Stamps { stamp_nanos } else { recorded_nanos };
        let mut made: Vec<Result<Made, NotMade>> = Vec::new();
        let is_placed = plan.grid.is_some() || !plan.positions.is_empty();
        if stamp.is_some()
            && (is_placed || self.options.clock == Clock::Stamps)
            && self.surveyed.part.is_some_and(|part| !part.contains(recorded_nanos))
        {
            return vec![Err(NotMade::OtherPart)];
        }
        if let Some(grid) = plan.grid {
            let same = stamp.and_then(|stamp| self.same_stamp(grid, (index, &known::frame(&message)), stamp, data));
            made.push(if let Some(why) = same {
                Err(why)
            } else if self.is_thinned(grid, index, &message, time_nanos) {
                Err(NotMade::Thinned)
            } else {
                self.grid(grid, index, &message, stamp_nanos)
            });
        }
        for (rule, state) in plan.states.iter().enumerate() {
            made.extend(states(rule, state, &message));
        }
        for rule in &plan.positions {
            made.extend(self.positions(rule, &message, stamp_nanos));
        }
        if let Some(rule) = &plan.traversals {
            made.push(traversal(rule, &message, time_nanos));
        }
        made.into_iter().map(|made| made.map(|made| Item { time_nanos, made })).collect()
    }

    /// Why a scan or a cloud is left out that has the stamp of another one.
    fn same_stamp(&mut self, grid: GridUse, (topic, frame): (usize, &str), stamp: i64, data: &[u8]) -> Option<NotMade> {
        if !matches!(grid, GridUse::Scans | GridUse::Clouds) {
            return None;
        }
        let sum = crc32fast::hash(data);
        let last = self.stamps.entry((topic, frame.to_owned())).or_default();
        if let Some((_, other)) = last.iter().find(|(other, _)| *other == stamp) {
            let has_own_time = self.options.clock == Clock::Recorder;
            return match *other == sum {
                true => Some(NotMade::Repeated),
                false => (!has_own_time).then_some(NotMade::SameStamp),
            };
        }
        if last.len() == LAST_STAMPS {
            last.pop_front();
        }
        last.push_back((stamp, sum));
        None
    }

    /// Whether a scan, a cloud or a grid follows another one of its topic and frame too soon. Changes of grids build
    /// upon each other, so all are taken.
    fn is_thinned(&mut self, grid: GridUse, topic: usize, message: &Value<'_>, time_nanos: i64) -> bool {
        let has_many_points = || Cloud::read(message).is_ok_and(|cloud| cloud.len() >= CLOUD_POINTS_MANY);
        let period_nanos = match self.options.period_nanos {
            None if grid == GridUse::Clouds && has_many_points() => CLOUD_PERIOD_NANOS,
            period_nanos => period_nanos.unwrap_or(0),
        };
        let has_changes = self.plan.topics.iter().any(|plan| plan.grid == Some(GridUse::GridChanges(topic)));
        if period_nanos <= 0 || matches!(grid, GridUse::GridChanges(_)) || has_changes {
            return false;
        }
        let slot = time_nanos.div_euclid(period_nanos);
        self.taken.insert((topic, known::frame(message)), slot) == Some(slot)
    }

    /// The pose of a frame at a time in the frame of the plan.
    fn pose(&self, frame: &str, stamp_nanos: i64) -> Result<Isometry3<f64>, NotMade> {
        match &self.plan.frame {
            _ if frame.is_empty() => Err(NotMade::Wrong("the message names no frame".to_owned())),
            None => Err(NotMade::NoFrame(frame.to_owned())),
            Some(within) => Ok(self.surveyed.frames.pose(frame, within, stamp_nanos)?),
        }
    }

    fn grid(&mut self, grid: GridUse, index: usize, message: &Value<'_>, stamp: i64) -> Result<Made, NotMade> {
        let frame = known::frame(message);
        match grid {
            GridUse::Scans => self.scan(index, message, &frame, stamp),
            GridUse::Clouds => self.cloud(index, message, &frame, stamp),
            GridUse::Grids => {
                let grid = Grid::read(message)?;
                let place = if frame.is_empty() { Isometry3::identity() } else { self.pose(&frame, stamp)? };
                let Grid { resolution_m, width, height, origin, .. } = grid;
                let percents: Vec<i8> = grid.percents().collect();
                if percents.iter().all(|percent| *percent < 0) {
                    return Err(NotMade::Nothing("the grid has no known cell"));
                }
                let placed = PlacedGrid { resolution_m, width, height, origin: place * origin, percents };
                let has_changes = self.plan.topics.iter().any(|plan| plan.grid == Some(GridUse::GridChanges(index)));
                if has_changes {
                    self.grids.insert(index, (placed.clone(), frame));
                }
                Ok(Made::Grid(placed))
            }
            GridUse::GridChanges(base) => {
                let update = GridUpdate::read(message)?;
                let Some((grid, _)) = self.grids.get_mut(&base) else {
                    return Err(NotMade::Wrong("no grid came before the change".to_owned()));
                };
                change(grid, &update)?;
                Ok(Made::Grid(grid.clone()))
            }
        }
    }

    fn positions(&self, rule: &PositionRule, message: &Value<'_>, stamp: i64) -> Vec<Result<Made, NotMade>> {
        let frame = known::frame(message);
        let frame = frame_name(&frame);
        // A message without a frame is taken as it is: there is nothing else to place it by.
        let place = if frame.is_empty() { Ok(Isometry3::identity()) } else { self.pose(frame, stamp) };
        let elements = rule.place.elements(message);
        elements
            .iter()
            .map(|element| {
                let point = rule.place.value(element);
                let [x, y, z] = match &point {
                    Some(point) => known::position(point, &[]).or_else(|error| {
                        if point.field("position").is_some() {
                            known::position(point, &["position"])
                        } else {
                            Err(error)
                        }
                    })?,
                    None => return Err(NotMade::Wrong("the field is missing".to_owned())),
                };
                let place = place.as_ref().map_err(NotMade::clone)?;
                let placed = place.transform_point(&[x, y, z].into());
                let state = rule.state.name(element).ok_or_else(no_name)?;
                let count = if rule.has_height { 3 } else { 2 };
                Ok(Made::Position { state, coordinates_m: placed.iter().take(count).copied().collect() })
            })
            .collect()
    }
}

fn no_name() -> NotMade {
    NotMade::Wrong("a field of the state's name is missing, or the name is too long".to_owned())
}

fn change(grid: &mut PlacedGrid, update: &GridUpdate<'_>) -> Result<(), NotMade> {
    let fits = |from: usize, count: usize, size: usize| from.checked_add(count).is_some_and(|end| end <= size);
    if !fits(update.x, update.width, grid.width) || !fits(update.y, update.height, grid.height) {
        return Err(NotMade::Wrong(format!(
            "a change of {} x {} cells at {}, {} does not lie within the grid of {} x {} cells",
            update.width, update.height, update.x, update.y, grid.width, grid.height
        )));
    }
    for (index, percent) in update.percents().enumerate() {
        let (row, column) = (update.y + index / update.width, update.x + index % update.width);
        if let Some(cell) = grid.percents.get_mut(row * grid.width + column) {
            *cell = percent;
        }
    }
    Ok(())
}

fn states(rule: usize, state: &StateRule, message: &Value<'_>) -> Vec<Result<Made, NotMade>> {
    let elements = state.place.elements(message);
    elements.iter().map(|element| one_state(rule, state, element)).collect()
}

fn one_state(rule: usize, state: &StateRule, element: &Value<'_>) -> Result<Made, NotMade> {
    let name = state.state.name(element).ok_or_else(no_name)?;
    let missing = || NotMade::Wrong("the field is missing".to_owned());
    let value = state.place.value(element).ok_or_else(missing)?;
    let number = |text: &str| text.parse::<f64>().map_err(|_| NotMade::Wrong(format!("{text:?} is no number")));
    let word = || shown(&value).ok_or_else(|| NotMade::Wrong("the field is neither a number nor text".to_owned()));
    let made = |value: f64| Ok(Made::Value { state: name.clone(), value, rule });
    match &state.value {
        ValueRule::Same(value) => made(*value),
        ValueRule::Table(table) => {
            let word = word()?;
            let to = table.get(&word).ok_or_else(|| NotMade::LeftOut(word.chars().take(SHOWN_CHARS).collect()))?;
            if state.kind == ValueKind::Categorical {
                Ok(Made::Label { state: name, label: to.clone(), rule })
            } else {
                made(number(to)?)
            }
        }
        ValueRule::Number if state.kind == ValueKind::Categorical => {
            Ok(Made::Label { state: name, label: word()?, rule })
        }
        ValueRule::Number => {
            let length = value.list().map(<[Value<'_>]>::len).or_else(|| value.numbers().map(|numbers| numbers.len()));
            match (value.number(), length) {
                (Some(value), _) => made(value),
                (None, Some(length)) => made(length as f64),
                (None, None) => made(number(&word()?)?),
            }
        }
    }
}

fn traversal(rule: &TraversalRule, message: &Value<'_>, end_nanos: i64) -> Result<Made, NotMade> {
    let text = |path: &crate::message::Path| {
        let value = path.value_in(message).and_then(|value| shown(&value));
        value.ok_or_else(|| NotMade::Wrong(format!("{path} is no text")))
    };
    let (from, to, status) = (text(&rule.from)?, text(&rule.to)?, text(&rule.status)?);
    let seconds = rule.seconds.value_in(message).and_then(|value| value.number()).unwrap_or(f64::NAN);
    if !(0.0..1e9).contains(&seconds) {
        return Err(NotMade::Wrong(format!("{} is {seconds}", rule.seconds)));
    }
    let success = rule.success.contains(&status.to_lowercase());
    let start_nanos = end_nanos.saturating_sub((seconds * 1e9) as i64);
    let reason = if success { String::new() } else { status };
    Ok(Made::Traversal { from, to, start_nanos, success, reason })
}

#[cfg(test)]
mod tests;
