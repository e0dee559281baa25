//! The tasks of a site, the kept plans of days, and the reports of runs.
//!
//! Invariant: the invariant of [`super::site`] holds here too.

/// A task.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Task {
    /// The activity of the task.
    #[prost(string, tag = "1")]
    pub kind: String,
    /// Name of the node where the task is done.
    #[prost(string, tag = "2")]
    pub node: String,
    /// Earliest start and latest end, seconds after local midnight.
    #[prost(uint32, tag = "3")]
    pub from_secs: u32,
    #[prost(uint32, tag = "4")]
    pub until_secs: u32,
    #[prost(uint32, tag = "5")]
    pub duration_secs: u32,
    /// A bit for each day of the week, Monday in the lowest; 0 where `day` is present.
    #[prost(uint32, tag = "6")]
    pub weekdays: u32,
    /// The only day on which the task is done, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "7")]
    pub day: Option<i32>,
    /// Length of the parts of the window; absent: it is not divided.
    #[prost(uint32, optional, tag = "8")]
    pub every_secs: Option<u32>,
    #[prost(fixed64, tag = "9")]
    pub value_bits: u64,
    /// Name of the state whose probability multiplies the value; empty: none.
    #[prost(string, tag = "10")]
    pub value_state: String,
}

/// The name of a task.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TaskName {
    #[prost(string, tag = "1")]
    pub kind: String,
    #[prost(string, tag = "2")]
    pub node: String,
}

/// A step of a plan: a task where `kind` is not empty, otherwise exploration.
#[derive(Clone, PartialEq, prost::Message)]
pub struct PlanStep {
    /// Time at which the robot departs for the step.
    #[prost(sint64, tag = "1")]
    pub departure_nanos: i64,
    /// Time from the departure to the beginning of the step.
    #[prost(sint64, tag = "2")]
    pub travel_nanos: i64,
    /// Duration of the step.
    #[prost(sint64, tag = "3")]
    pub duration_nanos: i64,
    #[prost(string, tag = "4")]
    pub kind: String,
    /// Name of the node, or of the explored location.
    #[prost(string, tag = "5")]
    pub place: String,
    /// Value of the task, or bits of information.
    #[prost(fixed64, tag = "6")]
    pub worth_bits: u64,
    /// Probability that nothing fails on the way; 0 for exploration.
    #[prost(fixed64, tag = "7")]
    pub success_bits: u64,
}

/// The plan of a day.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Plan {
    /// The day, in days since 1970-01-01.
    #[prost(sint32, tag = "1")]
    pub day: i32,
    #[prost(sint64, tag = "2")]
    pub made_nanos: i64,
    /// The steps, ascending by start.
    #[prost(message, repeated, tag = "3")]
    pub steps: Vec<PlanStep>,
}

/// A robot did a task, or tried to.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TaskRun {
    #[prost(string, tag = "1")]
    pub kind: String,
    #[prost(string, tag = "2")]
    pub node: String,
    #[prost(sint64, tag = "3")]
    pub start_nanos: i64,
    /// Duration of the run.
    #[prost(sint64, tag = "4")]
    pub duration_nanos: i64,
    #[prost(bool, tag = "5")]
    pub success: bool,
    /// Whether somebody had to help.
    #[prost(bool, tag = "6")]
    pub intervention: bool,
    /// Reason of the failure, at most 200 characters.
    #[prost(string, tag = "7")]
    pub reason: String,
}

/// The tasks, kept plans and reports of a site.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TaskBook {
    /// The tasks, ascending by kind, then by node.
    #[prost(message, repeated, tag = "1")]
    pub tasks: Vec<Task>,
    /// The kept plans, ascending by day.
    #[prost(message, repeated, tag = "2")]
    pub plans: Vec<Plan>,
    /// The reports of runs, ascending by start.
    #[prost(message, repeated, tag = "3")]
    pub runs: Vec<TaskRun>,
}

/// A change of the tasks.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TaskEdit {
    /// The change.
    #[prost(oneof = "TaskChange", tags = "1, 2, 3")]
    pub change: Option<TaskChange>,
}

/// The kinds of changes of the tasks.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum TaskChange {
    /// A task is added or replaced.
    #[prost(message, tag = "1")]
    Set(Task),
    /// A task is removed.
    #[prost(message, tag = "2")]
    Remove(TaskName),
    /// A plan is kept.
    #[prost(message, tag = "3")]
    KeepPlan(Plan),
}
