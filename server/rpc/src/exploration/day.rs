//! `PlanDay`: which slots of a day to explore, and where.
//!
//! Invariant: the information of a slot is predicted for its middle; a plan has a row per slot of the local day. A slot
//! in which a task is done, or the robot is on its way to one, does not explore.

use std::sync::Arc;

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    ids::StateId,
    task::{KeptPlan, KeptStep, KeptWork},
    view::MapView,
};
use tidemap_model::LocalDay;
use tidemap_plan::{
    day::{DayRow, DaySlots, plan_day as plan},
    strategy::Gains,
    tasks::PlannedTasks,
};
use tidemap_proto::{
    convert::{
        exploration::{DayQuestion, DayTargets, day_from_wire, day_to_wire},
        task::planned_to_wire,
    },
    v1,
};

use super::Explorations;
use crate::{
    lookup::{check_kind, find_map, find_state},
    series::predict_series,
    status::{PlanError, Problem, RpcError},
};

mod targets;

pub(super) async fn plan_day(
    explorations: &Explorations,
    request: v1::PlanDayRequest,
) -> Result<v1::PlanDayResponse, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let question = day_from_wire(request)?;
    Ok(explorations.planned_day(&handle, question).await?.reply())
}

/// The plan of a day.
pub(crate) struct PlannedDay {
    rows: Vec<DayRow>,
    /// Names of the targets to explore.
    names: Vec<String>,
    slots: DaySlots,
    /// The tasks, if they were requested.
    tasks: Option<PlannedTasks>,
}

impl PlannedDay {
    pub(crate) fn reply(&self) -> v1::PlanDayResponse {
        let mut reply = day_to_wire(&self.rows, &self.names);
        if let Some(tasks) = &self.tasks {
            planned_to_wire(tasks, &mut reply);
        }
        reply
    }

    /// The plan as a map keeps it.
    pub(crate) fn kept(&self, day: LocalDay, made_nanos: i64) -> KeptPlan {
        let explored = |row: &DayRow| {
            let (start_nanos, end_nanos) = (row.start_nanos, self.slots.start_nanos(row.slot + 1));
            let place = self.names.get(row.location?)?.clone();
            let work = KeptWork::Explore { place, information_bits: row.information_bits };
            Some(KeptStep { departure_nanos: start_nanos, start_nanos, end_nanos, work })
        };
        let tasks = self.tasks.iter().flat_map(|tasks| tasks.steps.iter().cloned());
        let mut steps: Vec<KeptStep> = self.rows.iter().filter_map(explored).chain(tasks).collect();
        steps.sort_by_key(|step| step.departure_nanos);
        KeptPlan { day, made_nanos, steps }
    }
}

impl Explorations {
    /// Plans a day: tasks first, if they are requested, then exploration.
    pub(crate) async fn planned_day(
        &self,
        handle: &Arc<MapHandle>,
        question: DayQuestion,
    ) -> Result<PlannedDay, RpcError> {
        let view = handle.view();
        let slots = DaySlots::of(&view.spec().zone, question.day, question.slot_nanos).map_err(PlanError::from)?;
        question.budget.visits(slots.count()).map_err(|error| PlanError::Day(error.into()))?;
        let tasks = match &question.tasks {
            Some(requested) => Some(self.routes.plan_tasks(handle, &view, slots, requested, question.selector).await?),
            None => None,
        };
        let has_locations = !view.site().locations().is_empty();
        let is_unnamed = matches!(&question.targets, DayTargets::Locations(names) if names.is_empty());
        if tasks.is_some() && is_unnamed && !has_locations {
            let free =
                |slot| DayRow { slot, start_nanos: slots.start_nanos(slot), location: None, information_bits: 0.0 };
            let rows = (0..slots.count()).map(free).collect();
            return Ok(PlannedDay { rows, names: Vec::new(), slots, tasks });
        }
        let states = task_states(&view, &question.task_states)?;
        let middles: Vec<i64> = (0..slots.count()).map(|slot| slots.middle_nanos(slot)).collect();
        let day = Day { explorations: self, handle, view: &view, middles, question: &question };
        let (names, information) = day.information().await?;
        let weighed = day.weighed(states, &names, &information).await?;
        let values = weighed.as_ref().unwrap_or(&information);
        let is_busy = |slot: usize| {
            let (from, until) = (slots.start_nanos(slot), slots.start_nanos(slot + 1));
            let overlaps = |step: &KeptStep| step.departure_nanos < until && step.end_nanos > from;
            tasks.as_ref().is_some_and(|tasks| tasks.steps.iter().any(overlaps))
        };
        let busy: Vec<bool> = (0..slots.count()).map(is_busy).collect();
        // While a task is done, no observation has a value.
        let value =
            |nanos, place| slots.slot_at(nanos).filter(|slot| !busy[*slot]).map_or(0.0, |slot| values.at(slot, place));
        let DayQuestion { strategy, budget, seed, .. } = question;
        let mut rows = plan(&slots, names.len(), value, strategy, budget, seed).map_err(PlanError::from)?;
        for row in &mut rows {
            row.location = row.location.filter(|_| !busy[row.slot]);
            row.information_bits = row.location.map_or(0.0, |place| information.at(row.slot, place));
        }
        Ok(PlannedDay { rows, names, slots, tasks })
    }
}

/// The states of the task.
fn task_states(view: &MapView, names: &[String]) -> Result<Vec<StateId>, RpcError> {
    let tasks = names.iter().map(|name| find_state(view, name)).collect::<Result<Vec<_>, _>>()?;
    for (i, &id) in tasks.iter().enumerate() {
        check_kind(view, id, &format!("task_states[{i}]"))?;
    }
    Ok(tasks)
}

/// A question about a day, and the view that answers it.
struct Day<'a> {
    explorations: &'a Explorations,
    handle: &'a Arc<MapHandle>,
    view: &'a Arc<MapView>,
    /// The middles of the slots, nanoseconds UTC.
    middles: Vec<i64>,
    question: &'a DayQuestion,
}

impl Day<'_> {
    /// The gains of information and task together; `None` if there is no task.
    async fn weighed(
        &self,
        tasks: Vec<StateId>,
        names: &[String],
        information: &Gains,
    ) -> Result<Option<Gains>, RpcError> {
        let (weight, selector) = (self.question.exploration_weight, self.question.selector);
        if weight >= 1.0 {
            return Ok(None);
        }
        if tasks.len() != names.len() {
            let problem = Problem::TaskStates { states: tasks.len(), locations: names.len() };
            return Err(problem.of("task_states").into());
        }
        let (context, requested) = (self.explorations.predict_context(), (tasks, self.middles.clone()));
        let of_tasks = predict_series(context, self.handle, self.view, requested, selector).await?;
        let task = Gains::of(self.middles.len(), names.len(), |slot, place| of_tasks[place][slot]);
        let weighed = task.and_then(|task| information.weighed(&task, weight));
        Ok(Some(weighed.map_err(|error| PlanError::Day(error.into()))?))
    }
}
