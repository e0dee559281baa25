//! `TaskService`: the tasks of a map, kept plans of days, and reports of what was done.
//!
//! Invariant: every change is durable before it is answered. A report is an observation, taken exactly once.

use std::sync::Arc;

use tidemap_ingest::catalog::Catalog;
use tidemap_map::{
    site::SiteEdit,
    task::{TaskEdit, task_weeks},
};
use tidemap_proto::{
    convert::{
        exploration::day_from_wire,
        observe::{StreamMessage, start_of_run},
        reports::{ReportMessage, SentReport},
        task::{
            hours_from_wire, plan_question_from_wire, plan_to_wire, run_from_wire, task_from_wire, task_name_from_wire,
            task_to_wire, week_to_wire,
        },
    },
    v1::{self, task_service_server::TaskService},
};
use tonic::{Request, Response};

use super::{
    RpcReply,
    exploration::Explorations,
    lookup::find_map,
    map::edit_site,
    observation::{Observations, SentAs},
    permits::{Permits, run_blocking},
    status::{PlanError, RpcError},
};

/// The service.
#[derive(Clone, Debug)]
pub(crate) struct Tasks {
    pub catalog: Arc<Catalog>,
    pub explorations: Explorations,
    pub observations: Observations,
    /// Permits to compute figures.
    pub(super) permits: Permits,
}

impl Tasks {
    async fn edit(&self, map: &str, edit: TaskEdit) -> Result<(), RpcError> {
        edit_site(&*find_map(&self.catalog, map).await?, SiteEdit::Task(edit)).await
    }

    fn now_nanos(&self) -> i64 {
        self.catalog.context().clock.now_nanos()
    }
}

#[tonic::async_trait]
impl TaskService for Tasks {
    async fn set_task(&self, request: Request<v1::SetTaskRequest>) -> RpcReply<v1::SetTaskResponse> {
        let v1::SetTaskRequest { map, task } = request.into_inner();
        find_map(&self.catalog, &map).await?;
        let task = task_from_wire(task).map_err(RpcError::from)?;
        let reply = v1::SetTaskResponse { task: Some(task_to_wire(&task)) };
        self.edit(&map, TaskEdit::Set(task)).await?;
        Ok(Response::new(reply))
    }

    async fn remove_task(&self, request: Request<v1::RemoveTaskRequest>) -> RpcReply<v1::RemoveTaskResponse> {
        let v1::RemoveTaskRequest { map, kind, node } = request.into_inner();
        find_map(&self.catalog, &map).await?;
        let name = task_name_from_wire("", &kind, &node).map_err(RpcError::from)?;
        self.edit(&map, TaskEdit::Remove(name)).await?;
        Ok(Response::new(v1::RemoveTaskResponse {}))
    }

    async fn list_tasks(&self, request: Request<v1::ListTasksRequest>) -> RpcReply<v1::ListTasksResponse> {
        let view = find_map(&self.catalog, &request.get_ref().map).await?.view();
        let tasks = view.site().tasks().tasks().map(task_to_wire).collect();
        Ok(Response::new(v1::ListTasksResponse { tasks }))
    }

    async fn keep_plan(&self, request: Request<v1::KeepPlanRequest>) -> RpcReply<v1::PlanDayResponse> {
        let v1::KeepPlanRequest { map, day } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let question = day_from_wire(v1::PlanDayRequest { map, ..day.unwrap_or_default() }).map_err(RpcError::from)?;
        let day = question.day;
        let planned = self.explorations.planned_day(&handle, question).await?;
        let kept = planned.kept(day, self.now_nanos());
        edit_site(&handle, SiteEdit::Task(TaskEdit::KeepPlan(kept))).await?;
        Ok(Response::new(planned.reply()))
    }

    async fn get_plan(&self, request: Request<v1::GetPlanRequest>) -> RpcReply<v1::GetPlanResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let question = plan_question_from_wire(&request).map_err(RpcError::from)?;
        let time_nanos = question.time_nanos.unwrap_or_else(|| self.now_nanos());
        let day = question.day.unwrap_or_else(|| view.spec().zone.day_of(time_nanos));
        let no_plan = || RpcError::from(PlanError::NoPlan { map: request.map.clone(), day });
        let plan = view.site().tasks().plan(day).ok_or_else(no_plan)?;
        Ok(Response::new(plan_to_wire(plan, time_nanos)))
    }

    async fn report_task(&self, request: Request<v1::ReportTaskRequest>) -> RpcReply<v1::ReportTaskResponse> {
        let request = request.into_inner();
        find_map(&self.catalog, &request.map).await?;
        let run = run_from_wire(&request, self.now_nanos()).map_err(RpcError::from)?;
        // Without an end time the daemon takes the time of the request, which differs when the request is sent again.
        let once = request.end_time.is_none().then_some(1);
        let sent_as = SentAs {
            start: start_of_run(&request).map_err(RpcError::from)?,
            map: request.map,
            first_sequence: request.sequence,
            may_differ: once,
        };
        let items = |first| Ok(StreamMessage::Reports(ReportMessage::new(first, vec![SentReport::of_run(run)])?));
        let taken = self.observations.take_items(sent_as, items).await?;
        let durable_sequence = taken.durable_sequence;
        Ok(Response::new(v1::ReportTaskResponse { durable_sequence, refused: taken.refused_to_wire() }))
    }

    async fn list_task_weeks(&self, request: Request<v1::ListTaskWeeksRequest>) -> RpcReply<v1::ListTaskWeeksResponse> {
        let request = request.into_inner();
        let view = find_map(&self.catalog, &request.map).await?.view();
        let hours = hours_from_wire(&request).map_err(RpcError::from)?;
        let weeks = move || task_weeks(view.site().tasks().runs(), &view.spec().zone, hours);
        let weeks = run_blocking(self.permits.take().await?, weeks).await?;
        Ok(Response::new(v1::ListTaskWeeksResponse { weeks: weeks.iter().map(week_to_wire).collect() }))
    }
}
