//! The tasks of a day, planned over the topological map.
//!
//! Invariant: tasks, forecasts and values are of one view. A task that cannot be planned has a reason and does not
//! affect the others.

use std::{collections::HashMap, sync::Arc, time::Duration};

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    event::StateKind,
    ids::StateId,
    name::StateName,
    task::CHARGE_KIND,
    topology::{NodeId, Topology},
    view::MapView,
};
use tidemap_model::{StopSignal, selector::ModelSelector};
use tidemap_plan::{
    day::DaySlots,
    route::RouteOptions,
    tasks::{MapDay, Occurrence, PlannedTasks, occurrences},
};
use tidemap_proto::convert::{exploration::DayTasks, search::speed_from_wire};

use super::{
    Routes,
    edges::{Edges, ForecastsFrom},
    places::find_node,
};
use crate::{
    series::predict_series,
    status::{PlanError, RpcError},
};

/// Maximum time for a plan.
const WITHIN: Duration = Duration::from_secs(60);

impl Routes {
    /// Plans the tasks of a local day.
    pub(crate) async fn plan_tasks(
        &self,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        slots: DaySlots,
        requested: &DayTasks,
        selector: ModelSelector,
    ) -> Result<PlannedTasks, RpcError> {
        let topology = self.open_topology(view).await?;
        let start = start_node(view, &topology, requested.start_node.as_deref())?;
        let chances = self.chances(handle, view, &slots, requested, selector).await?;
        let edges = Edges::new(self, handle, view, ModelSelector::default(), speed_from_wire(0.0)?).await?;
        let (view, requested) = (Arc::clone(view), requested.clone());
        let work = move |stop: StopSignal<'_>| {
            let occurrences = occurrences(view.site().tasks().tasks(), &view.spec().zone, requested.day);
            let first_nanos = slots.start_nanos(0);
            // Times of the day before `ready_nanos` are over.
            let ready_nanos = requested.ready_nanos.unwrap_or(first_nanos).max(first_nanos);
            let RouteOptions { recovery_secs, failure_cost_secs, .. } = RouteOptions::default();
            let day = MapDay {
                topology: &topology,
                slots: &slots,
                occurrences: &occurrences,
                start,
                ready_nanos,
                recovery_secs,
                failure_cost_secs,
            };
            let mut ahead = ForecastsFrom { edges: &edges, reference_nanos: first_nanos, people: None };
            day.plan(&mut ahead, |state| chances.get(state).cloned(), stop)
        };
        Ok(self.run_plan(Some(WITHIN), work).await?.map_err(PlanError::from)?)
    }

    /// The probability of each state that values depend on, in the middle of each slot.
    async fn chances(
        &self,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        slots: &DaySlots,
        requested: &DayTasks,
        selector: ModelSelector,
    ) -> Result<HashMap<StateName, Vec<f64>>, RpcError> {
        let on_day = occurrences(view.site().tasks().tasks(), &view.spec().zone, requested.day);
        let of_task = |Occurrence { task, .. }: &Occurrence<'_>| task.value_state.clone();
        let mut names: Vec<StateName> = on_day.iter().filter_map(of_task).collect();
        names.sort_unstable();
        names.dedup();
        let found = |name: StateName| {
            let state = view.find(name.as_str()).filter(|&id| view.kind(id) == StateKind::Probability)?;
            Some((name, state))
        };
        let (names, states): (Vec<StateName>, Vec<StateId>) = names.into_iter().filter_map(found).unzip();
        let middles: Vec<i64> = (0..slots.count()).map(|slot| slots.middle_nanos(slot)).collect();
        let rows = predict_series(self.predict_context(), handle, view, (states, middles), selector).await?;
        Ok(names.into_iter().zip(rows).collect())
    }
}

/// The node where the robot is at first: the node that is named, or that of the charger.
fn start_node(view: &MapView, topology: &Topology, named: Option<&str>) -> Result<NodeId, RpcError> {
    let map = view.spec().name.as_str();
    if let Some(name) = named {
        return Ok(find_node(map, topology, name)?);
    }
    let away_m = |charger: [f64; 2], at: [f64; 2]| (charger[0] - at[0]).hypot(charger[1] - at[1]);
    let nearest = view.site().charger_m().and_then(|charger| {
        let placed = topology.nodes().filter_map(|node| Some((node.id, node.pose?)));
        placed
            .map(|(id, pose)| (away_m(charger, [pose.x_m, pose.y_m]), id))
            .min_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)))
            .map(|(_, id)| id)
    });
    let mut charging = view.site().tasks().tasks().filter(|task| task.name.kind.as_str() == CHARGE_KIND);
    let by_task = || charging.find_map(|task| topology.node_named(task.name.node.as_str()).ok()).map(|node| node.id);
    // If there is no node at all, this error names what is missing.
    if topology.nodes().len() == 0 {
        find_node(map, topology, "")?;
    }
    Ok(nearest.or_else(by_task).ok_or(PlanError::NoStartNode)?)
}
