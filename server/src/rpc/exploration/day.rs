//! `PlanDay`: which slots of a day to explore, and where.
//!
//! Invariant: the information of a slot is predicted for its middle; a plan has a row per slot of the local day.

use std::sync::Arc;

use tidemap_map::{ids::StateId, view::MapView};
use tidemap_plan::{
    day::{DaySlots, plan_day as plan},
    strategy::Gains,
};
use tidemap_proto::{
    convert::exploration::{DayQuestion, day_from_wire, day_to_wire},
    v1,
};

use super::Explorations;
use crate::{
    ingest::handle::MapHandle,
    rpc::{
        lookup::{check_kind, find_map, find_state},
        series::predict_series,
        status::{PlanError, Problem, RpcError},
    },
};

mod targets;

pub(super) async fn plan_day(
    explorations: &Explorations,
    request: v1::PlanDayRequest,
) -> Result<v1::PlanDayResponse, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let question = day_from_wire(request)?;
    let view = handle.view();
    let slots = DaySlots::of(&view.spec().zone, question.day, question.slot_nanos).map_err(PlanError::from)?;
    question.budget.visits(slots.count()).map_err(|error| PlanError::Day(error.into()))?;
    let tasks = task_states(&view, &question.task_states)?;
    let middles: Vec<i64> = (0..slots.count()).map(|slot| slots.middle_nanos(slot)).collect();
    let day = Day { explorations, handle: &handle, view: &view, middles, question: &question };
    let (names, information) = day.information().await?;
    let weighed = day.weighed(tasks, &names, &information).await?;
    let values = weighed.as_ref().unwrap_or(&information);
    let value = |nanos, place| slots.slot_at(nanos).map_or(0.0, |slot| values.at(slot, place));
    let DayQuestion { strategy, budget, seed, .. } = question;
    let mut rows = plan(&slots, names.len(), value, strategy, budget, seed).map_err(PlanError::from)?;
    for row in &mut rows {
        row.information_bits = row.location.map_or(0.0, |place| information.at(row.slot, place));
    }
    Ok(day_to_wire(&rows, &names))
}

/// The states of the task.
fn task_states(view: &MapView, names: &[String]) -> Result<Vec<StateId>, RpcError> {
    let tasks = names.iter().map(|name| find_state(view, name)).collect::<Result<Vec<_>, _>>()?;
    for (i, &id) in tasks.iter().enumerate() {
        check_kind(view, id, &format!("task_states[{i}]"))?;
    }
    Ok(tasks)
}

/// A question, and the view that answers it.
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
        let (context, asked) = (self.explorations.predict_context(), (tasks, self.middles.clone()));
        let of_tasks = predict_series(context, self.handle, self.view, asked, selector).await?;
        let task = Gains::of(self.middles.len(), names.len(), |slot, place| of_tasks[place][slot]);
        let weighed = task.and_then(|task| information.weighed(&task, weight));
        Ok(Some(weighed.map_err(|error| PlanError::Day(error.into()))?))
    }
}
