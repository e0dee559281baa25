//! Tasks, the kept plans of days, and reports of done tasks.
//!
//! Invariant: a change is durable when a method returns; a reply with invalid names is an error.

pub use tidemap_map::{
    name::TaskName,
    task::{AllowedHours, CHARGE_KIND, KeptPlan, KeptStep, KeptWork, RobotTask, TaskDays, TaskRun, TaskWeek},
};
pub use tidemap_model::LocalDay;
pub use tidemap_plan::tasks::{PlannedTasks, UnservedReason, UnservedTask};
use tidemap_proto::{
    convert::{
        InvalidField,
        task::{plan_from_wire, planned_from_wire, task_from_wire, task_to_wire, week_from_wire},
        time::timestamp,
    },
    v1::{self, task_service_client::TaskServiceClient},
};

use crate::{
    connection::{Client, Connection},
    error::Error,
    exploration::{DayQuery, DaySlot, day_request, day_slots},
};

/// The query of a plan for the tasks of a day.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskQuery {
    /// Name of the node where the robot is at first; `None`: the node of the charger.
    pub start_node: Option<String>,
    /// The time from which on the robot is ready, nanoseconds UTC; `None`: from the beginning of the day.
    pub ready_nanos: Option<i64>,
    /// Whether the map keeps the plan.
    pub keep: bool,
}

/// The plan of a day with its tasks.
#[derive(Clone, Debug, PartialEq)]
pub struct DayPlan {
    /// The slots; a slot without a task may explore.
    pub slots: Vec<DaySlot>,
    /// The tasks.
    pub tasks: PlannedTasks,
}

/// The receipt of a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskReceipt {
    /// All reports of the sequence up to this number are durable, or refused.
    pub durable_sequence: u64,
    /// Why the report was refused.
    pub refused: Option<String>,
}

fn broken(_: InvalidField) -> Error {
    Error::Protocol("a name or a date of a task is not valid")
}

impl Client {
    fn task_service(&self) -> TaskServiceClient<Connection> {
        TaskServiceClient::new(self.requests())
    }

    /// Adds a task, or replaces the task of the same kind and node.
    ///
    /// # Errors
    /// [`Error`]; the code is `INVALID_ARGUMENT` if a number of the task is invalid.
    pub async fn set_task(&self, map: &str, task: &RobotTask) -> Result<RobotTask, Error> {
        let request = v1::SetTaskRequest { map: map.to_owned(), task: Some(task_to_wire(task)) };
        let answer = self.task_service().set_task(request).await.map_err(|status| self.error(&status))?;
        task_from_wire(answer.into_inner().task).map_err(broken)
    }

    /// Removes a task.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or the task does not exist.
    pub async fn remove_task(&self, map: &str, kind: &str, node: &str) -> Result<(), Error> {
        let request = v1::RemoveTaskRequest { map: map.to_owned(), kind: kind.to_owned(), node: node.to_owned() };
        self.task_service().remove_task(request).await.map(drop).map_err(|status| self.error(&status))
    }

    /// The tasks of a map, by kind and then by node.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn tasks(&self, map: &str) -> Result<Vec<RobotTask>, Error> {
        let request = v1::ListTasksRequest { map: map.to_owned() };
        let answer = self.task_service().list_tasks(request).await.map_err(|status| self.error(&status))?;
        let tasks = answer.into_inner().tasks.into_iter();
        tasks.map(|task| task_from_wire(Some(task)).map_err(broken)).collect()
    }

    /// Plans the tasks of a local day, and what to explore in the slots that are left over.
    ///
    /// # Errors
    /// [`Error`]; as [`Client::plan_day`], and `FAILED_PRECONDITION` if the map has no topology, or no start is known.
    pub async fn plan_tasks(&self, query: DayQuery, tasks: TaskQuery) -> Result<DayPlan, Error> {
        let map = query.map.clone();
        let request = v1::PlanDayRequest {
            tasks: true,
            start_node: tasks.start_node.unwrap_or_default(),
            ready_time: tasks.ready_nanos.map(timestamp),
            ..day_request(query)
        };
        let answer = if tasks.keep {
            self.task_service().keep_plan(v1::KeepPlanRequest { map, day: Some(request) }).await
        } else {
            self.exploration_service().plan_day(request).await
        };
        let answer = answer.map_err(|status| self.error(&status))?.into_inner();
        let tasks = planned_from_wire(&answer).map_err(broken)?;
        Ok(DayPlan { slots: day_slots(answer), tasks })
    }

    /// The kept plan of a day (`YYYY-MM-DD`; by default the day of the time), and the index of the step at a time, by
    /// default now.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if no plan of that day was kept.
    pub async fn kept_plan(
        &self,
        map: &str,
        date: Option<&str>,
        time_nanos: Option<i64>,
    ) -> Result<(KeptPlan, Option<usize>), Error> {
        let (map, date) = (map.to_owned(), date.unwrap_or_default().to_owned());
        let request = v1::GetPlanRequest { map, date, time: time_nanos.map(timestamp) };
        let answer = self.task_service().get_plan(request).await.map_err(|status| self.error(&status))?;
        plan_from_wire(&answer.into_inner()).map_err(broken)
    }

    /// Reports that a robot did a task, or tried to. `sequence`: number of the report in the sequence of the producer
    /// and label; sent again, it is taken once. 0: the next one.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if another report had the number.
    pub async fn report_task(
        &self,
        map: &str,
        (producer, label): (&str, &str),
        sequence: u64,
        run: &TaskRun,
    ) -> Result<TaskReceipt, Error> {
        let TaskRun { name, start_nanos, end_nanos, success, intervention, reason } = run.clone();
        let request = v1::ReportTaskRequest {
            map: map.to_owned(),
            producer: producer.to_owned(),
            label: label.to_owned(),
            sequence,
            kind: name.kind.to_string(),
            node: name.node.to_string(),
            start_time: Some(timestamp(start_nanos)),
            end_time: Some(timestamp(end_nanos)),
            success,
            reason,
            intervention,
        };
        let answer = self.task_service().report_task(request).await.map_err(|status| self.error(&status))?;
        let v1::ReportTaskResponse { durable_sequence, refused } = answer.into_inner();
        Ok(TaskReceipt { durable_sequence, refused: refused.into_iter().next().map(|refusal| refusal.detail) })
    }

    /// The autonomy of the robots of a map, week by week.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn task_weeks(&self, map: &str, hours: AllowedHours) -> Result<Vec<TaskWeek>, Error> {
        let AllowedHours { from_secs, until_secs, weekdays } = hours;
        let request =
            v1::ListTaskWeeksRequest { map: map.to_owned(), from_secs, until_secs, weekdays: weekdays.into() };
        let answer = self.task_service().list_task_weeks(request).await.map_err(|status| self.error(&status))?;
        answer.into_inner().weeks.iter().map(|week| week_from_wire(week).map_err(broken)).collect()
    }
}
