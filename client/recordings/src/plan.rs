//! The plan of a recording: the observations that are made of each topic.
//!
//! Invariant: every topic of a survey has its plan, and a topic that becomes nothing has the reason. A mapping whose
//! topics and fields are not in the recording is an error before anything is made.

mod frame;
mod poses;

use crate::{
    definition::Count,
    frames::GAP_NANOS,
    known::{self, pose_path},
    layout::Kind,
    mapping::{Mapping, PositionRule, Reports, StateRule, Template, TraversalRule, ValueKind, ValueRule},
    survey::{PoseSource, Surveyed, TopicSurvey, is_transforms},
};

pub use self::{frame::FrameChoice, poses::pose_topics};

/// The use of a topic for the grid of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridUse {
    /// Scans of planar range finders.
    Scans,
    /// Point clouds.
    Clouds,
    /// Occupancy grids.
    Grids,
    /// Changes of the occupancy grids of another topic, by its index.
    GridChanges(usize),
}

/// The observations that are made of one topic.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopicPlan {
    /// Frames.
    pub is_transforms: bool,
    /// Poses that are taken in place of transforms.
    pub gives_poses: bool,
    /// Observations of the grid.
    pub grid: Option<GridUse>,
    /// Observations of states.
    pub states: Vec<StateRule>,
    /// Observations of positions.
    pub positions: Vec<PositionRule>,
    /// Traversals.
    pub traversals: Option<TraversalRule>,
    /// Why it becomes nothing.
    pub skipped: Option<String>,
}

impl TopicPlan {
    /// Whether its messages become observations.
    pub fn is_observed(&self) -> bool {
        self.grid.is_some() || !self.states.is_empty() || !self.positions.is_empty() || self.traversals.is_some()
    }

    /// The observations that are made of the topic, in words.
    pub fn becomes(&self) -> String {
        let mut words: Vec<String> = Vec::new();
        match self.grid {
            Some(GridUse::Scans) => words.push("scans".to_owned()),
            Some(GridUse::Clouds) => words.push("clouds".to_owned()),
            Some(GridUse::Grids) => words.push("grids".to_owned()),
            Some(GridUse::GridChanges(_)) => words.push("changes of grids".to_owned()),
            None => {}
        }
        words.extend(self.states.iter().map(|rule| format!("state {}", rule.state.text())));
        words.extend(self.positions.iter().map(|rule| format!("positions {}", rule.state.text())));
        if self.traversals.is_some() {
            words.push("traversals".to_owned());
        }
        if self.is_transforms || self.gives_poses {
            words.push("frames".to_owned());
        }
        if words.is_empty() { "nothing".to_owned() } else { words.join(", ") }
    }
}

/// The observations that are made of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plan {
    /// The plan of each topic, in the order of the survey.
    pub topics: Vec<TopicPlan>,
    /// The frame in which everything is placed; absent if nothing has to be placed.
    pub frame: Option<String>,
    /// The reason for the choice of the frame.
    pub choice: FrameChoice,
}

impl Plan {
    /// The cells of the grids, if grids alone are taken: their edge in metres, and where they begin, less than a cell
    /// from the origin.
    pub fn cells(&self, surveyed: &Surveyed) -> Option<(f64, [f64; 2])> {
        let mut topics = surveyed.topics.iter().zip(&self.topics);
        if topics.clone().any(|(_, plan)| matches!(plan.grid, Some(GridUse::Scans | GridUse::Clouds))) {
            return None;
        }
        let (topic, _) = topics.find(|(topic, plan)| plan.grid == Some(GridUse::Grids) && topic.grid.is_some())?;
        let (resolution_m, origin_m) = topic.grid?;
        let is_of_frame = self.frame.as_ref().is_none_or(|frame| *frame == topic.frame);
        let within = |along: f64| {
            let rest = along - (along / resolution_m).round() * resolution_m;
            if is_of_frame && rest.abs() > 1e-6 * resolution_m { rest } else { 0.0 }
        };
        Some((resolution_m, origin_m.map(within)))
    }

    /// Whether the scans and grids of the recording lie level, so that a flat grid can take them: there are no clouds,
    /// and no sensor leans.
    pub fn is_level(&self, surveyed: &Surveyed) -> bool {
        let mut grids = surveyed.topics.iter().zip(&self.topics).filter_map(|(topic, plan)| Some((topic, plan.grid?)));
        grids.all(|(topic, grid)| match grid {
            GridUse::Grids | GridUse::GridChanges(_) => true,
            GridUse::Clouds => false,
            GridUse::Scans => frame::is_level(surveyed, topic, self.frame.as_deref()),
        })
    }
}

/// Why no plan can be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// The mapping, or a list of topics, names a topic that the recording does not have.
    #[error("the recording has no topic {name:?}; it has {topics}")]
    NoTopic {
        /// The name.
        name: String,
        /// The topics of the recording.
        topics: String,
    },
    /// The mapping names a field that the topic does not have.
    #[error("{topic}: {problem}")]
    Field {
        /// The topic.
        topic: String,
        /// The fault.
        problem: String,
    },
    /// The topic whose poses are to be taken does not have any.
    #[error("{problem}; {candidates}")]
    NoPoses {
        /// The fault.
        problem: String,
        /// The topics that would do, in words.
        candidates: String,
    },
    /// The requested frame is in no transform and no message.
    #[error("the recording has no frame {frame:?}; it has {frames}")]
    NoFrame {
        /// The frame.
        frame: String,
        /// Frames of the recording.
        frames: String,
    },
}

/// The choices of the user.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wishes {
    /// The mapping.
    pub mapping: Mapping,
    /// The topics to take; all if empty.
    pub topics: Vec<String>,
    /// The frame in which everything is placed.
    pub frame: Option<String>,
    /// The longest time between two transforms that differ, nanoseconds; that of the mapping if absent.
    pub transform_gap_nanos: Option<i64>,
    /// The topic whose poses are taken in place of transforms; that of the mapping if absent.
    pub pose_from: Option<PoseSource>,
}

impl Wishes {
    /// The topic whose poses are taken in place of transforms.
    pub fn pose_source(&self) -> Option<&PoseSource> {
        self.pose_from.as_ref().or(self.mapping.pose_from.as_ref())
    }

    /// The longest time between two transforms that differ, nanoseconds.
    pub fn gap_nanos(&self) -> i64 {
        self.transform_gap_nanos.or(self.mapping.transform_gap_nanos).unwrap_or(GAP_NANOS)
    }
}

/// Makes a plan.
///
/// # Errors
/// The wishes name topics, fields or frames that the recording does not have.
pub fn plan(surveyed: &Surveyed, wishes: &Wishes) -> Result<Plan, PlanError> {
    let topics = &surveyed.topics;
    for name in wishes.mapping.topics().chain(wishes.topics.iter().map(String::as_str)) {
        if !topics.iter().any(|topic| topic.name == name) {
            let names: Vec<&str> = topics.iter().take(50).map(|topic| topic.name.as_str()).collect();
            return Err(PlanError::NoTopic { name: name.to_owned(), topics: names.join(", ") });
        }
    }
    let mut plans = topics.iter().map(|topic| topic_plan(topic, wishes)).collect::<Result<Vec<_>, _>>()?;
    if let Some(source) = wishes.pose_source() {
        let index = poses::topic(surveyed, source)?;
        if let Some(plan) = plans.get_mut(index) {
            plan.gives_poses = true;
        }
    }
    prefer_scans(surveyed, &mut plans, wishes);
    find_changed_grids(topics, &mut plans);
    let (frame, choice) = frame::choose(surveyed, &plans, wishes.frame.as_deref())?;
    Ok(Plan { topics: plans, frame, choice })
}

fn topic_plan(topic: &TopicSurvey, wishes: &Wishes) -> Result<TopicPlan, PlanError> {
    let mapping = &wishes.mapping;
    let skipped = |why: String| Ok(TopicPlan { skipped: Some(why), ..TopicPlan::default() });
    if mapping.skip.contains(&topic.name) {
        return skipped("the mapping leaves it out".to_owned());
    }
    if is_transforms(&topic.type_name) {
        return Ok(TopicPlan { is_transforms: true, ..TopicPlan::default() });
    }
    if !wishes.topics.is_empty() && !wishes.topics.contains(&topic.name) {
        return skipped("it is not among the requested topics".to_owned());
    }
    let plan = if is_mapped(topic, mapping) { mapped(topic, mapping)? } else { usual(topic) };
    if plan.is_observed() && topic.messages == 0 {
        return skipped("it has no messages".to_owned());
    }
    if !plan.is_observed() && plan.skipped.is_none() {
        return skipped(match &topic.problem {
            Some(problem) if topic.unread == topic.messages => problem.clone(),
            _ if topic.messages == 0 => "it has no messages".to_owned(),
            _ => format!("nothing is made of {} without a mapping", topic.type_name),
        });
    }
    Ok(plan)
}

fn is_mapped(topic: &TopicSurvey, mapping: &Mapping) -> bool {
    mapping.states.iter().any(|rule| rule.place.topic == topic.name)
        || mapping.positions.iter().any(|rule| rule.place.topic == topic.name)
        || mapping.traversals.iter().any(|rule| rule.topic == topic.name)
}

/// The plan of a topic that the mapping names.
fn mapped(topic: &TopicSurvey, mapping: &Mapping) -> Result<TopicPlan, PlanError> {
    let states: Vec<StateRule> = mapping.states.iter().filter(|rule| rule.place.topic == topic.name).cloned().collect();
    let positions: Vec<PositionRule> =
        mapping.positions.iter().filter(|rule| rule.place.topic == topic.name).cloned().collect();
    let traversals = mapping.traversals.iter().find(|rule| rule.topic == topic.name).cloned();
    let wrong = |problem: String| PlanError::Field { topic: topic.name.clone(), problem };
    let Some(layout) = &topic.layout else {
        let problem = topic.problem.clone().unwrap_or_else(|| "its definition cannot be read".to_owned());
        return Err(wrong(problem));
    };
    let places = states.iter().map(|rule| &rule.place).chain(positions.iter().map(|rule| &rule.place));
    for place in places {
        let mut within = layout.clone();
        if let Some(each) = &place.each {
            let field = each.field_in(layout).map_err(|error| wrong(error.to_string()))?;
            if field.count == Count::One || each.ends_with_index() {
                return Err(wrong(format!("{each} is no array: leave [] out")));
            }
            match &field.kind {
                Kind::Structure(inner) => within = inner.clone(),
                Kind::Primitive(_) if place.field.is_some() => {
                    return Err(wrong(format!("the elements of {each} have no fields")));
                }
                Kind::Primitive(_) => continue,
            }
        }
        if let Some(field) = &place.field {
            field.field_in(&within).map_err(|error| wrong(error.to_string()))?;
        }
    }
    if let Some(TraversalRule { from, to, seconds, status, .. }) = &traversals {
        for path in [from, to, seconds, status] {
            path.field_in(layout).map_err(|error| wrong(error.to_string()))?;
        }
    }
    Ok(TopicPlan { states, positions, traversals, ..usual_grid(topic) })
}

fn usual_grid(topic: &TopicSurvey) -> TopicPlan {
    let grid = match topic.type_name.as_str() {
        name if known::is_scan(name) => Some(GridUse::Scans),
        name if known::is_cloud(name) => Some(GridUse::Clouds),
        "nav_msgs/OccupancyGrid" => Some(GridUse::Grids),
        "map_msgs/OccupancyGridUpdate" => Some(GridUse::GridChanges(usize::MAX)),
        _ => None,
    };
    TopicPlan { grid, ..TopicPlan::default() }
}

/// The plan of a topic without a mapping, by its type.
fn usual(topic: &TopicSurvey) -> TopicPlan {
    let name = state_name(&topic.name);
    let name = Template::plain(&name);
    let mut plan = usual_grid(topic);
    let type_name = topic.type_name.as_str();
    match type_name {
        "std_msgs/Bool" => plan.states.extend(StateRule::plain(&topic.name, "data", name, ValueRule::Number)),
        "rmf_door_msgs/DoorState" => plan.states.extend(door(&topic.name)),
        "strands_navigation_msgs/NavStatistics" | "topological_navigation_msgs/NavStatistics" => {
            plan.traversals = TraversalRule::strands(&topic.name);
        }
        "people_msgs/People" => {
            let person = Template::plain("person");
            plan.positions.extend(PositionRule::plain(&topic.name, Some("people"), "position", person));
        }
        "people_msgs/PositionMeasurementArray" => {
            let person = Template::plain("person");
            plan.positions.extend(PositionRule::plain(&topic.name, Some("people"), "pos", person));
        }
        "people_msgs/PositionMeasurement" => {
            plan.positions.extend(PositionRule::plain(&topic.name, None, "pos", Template::plain("person")));
        }
        "spencer_tracking_msgs/TrackedPersons" => {
            let person = Template::plain("person");
            plan.positions.extend(PositionRule::plain(&topic.name, Some("tracks"), "pose.pose.position", person));
        }
        "geometry_msgs/PointStamped" => {
            plan.positions.extend(PositionRule::plain(&topic.name, None, "point", name));
        }
        _ => {
            if let Some(path) = pose_path(type_name) {
                let field: Vec<&str> = path.iter().copied().chain(["position"]).collect();
                plan.positions.extend(PositionRule::plain(&topic.name, None, &field.join("."), name));
            }
        }
    }
    plan
}

/// Doors: open is 1, closed 0; a door that moves, is offline or unknown gives no value.
fn door(topic: &str) -> Option<StateRule> {
    let table = [("0", "0"), ("2", "1")].map(|(from, to)| (from.to_owned(), to.to_owned()));
    let name = Template::read("{door_name}").ok()?;
    let rule = StateRule::plain(topic, "current_mode.value", name, ValueRule::Table(table.into()))?;
    Some(StateRule { kind: ValueKind::Probability, reports: Reports::Samples, ..rule })
}

/// The name of a state that is named after its topic: slashes separate the parts of names, so they become `-`.
fn state_name(topic: &str) -> String {
    topic.trim_matches('/').replace('/', "-")
}

/// Leaves out grids that were made from scans that are also taken, and grids of costs.
fn prefer_scans(surveyed: &Surveyed, plans: &mut [TopicPlan], wishes: &Wishes) {
    let is_placed = |topic: &TopicSurvey, plan: &TopicPlan| {
        matches!(plan.grid, Some(GridUse::Scans | GridUse::Clouds))
            && (has_moving_link(surveyed, &topic.frame) || wishes.frame.as_ref() == Some(&topic.frame))
    };
    let has_scans = surveyed.topics.iter().zip(&*plans).any(|(topic, plan)| is_placed(topic, plan));
    for (topic, plan) in surveyed.topics.iter().zip(plans) {
        let is_grid = matches!(plan.grid, Some(GridUse::Grids | GridUse::GridChanges(_)));
        if !is_grid || wishes.mapping.grid.contains(&topic.name) {
            continue;
        }
        let why = if topic.name.contains("costmap") {
            "it has costs, not occupancy: name it under grid: in a mapping to take it"
        } else if has_scans {
            "the scans are taken, of which such grids are made: name it under grid: in a mapping to take it as well"
        } else {
            continue;
        };
        plan.grid = None;
        if !plan.is_observed() {
            plan.skipped = Some(why.to_owned());
        }
    }
}

/// Whether a frame moves within another one.
fn has_moving_link(surveyed: &Surveyed, frame: &str) -> bool {
    surveyed.frames.chain(frame).iter().any(|name| surveyed.frames.moves(name))
}

/// Finds the topic of the grids to which the changes of another topic belong: `/map_updates` belongs to `/map`.
fn find_changed_grids(topics: &[TopicSurvey], plans: &mut [TopicPlan]) {
    let is_grid: Vec<bool> = plans.iter().map(|plan| plan.grid == Some(GridUse::Grids)).collect();
    for (index, topic) in topics.iter().enumerate() {
        let Some(plan) = plans.get_mut(index) else { continue };
        if !matches!(plan.grid, Some(GridUse::GridChanges(_))) {
            continue;
        }
        let base = topic.name.strip_suffix("_updates").unwrap_or(&topic.name);
        let found = topics.iter().zip(&is_grid).position(|(other, is_grid)| *is_grid && other.name == base);
        plan.grid = found.map(GridUse::GridChanges);
        if found.is_none() && !plan.is_observed() {
            plan.skipped = Some(format!("no grids of topic {base} are taken, whose changes these are"));
        }
    }
}

#[cfg(test)]
mod tests;
