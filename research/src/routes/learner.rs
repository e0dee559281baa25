//! The map of a learning robot: it applies the robot's reports as a daemon does, and is updated at midnight.
//!
//! Invariant: forecasts of edges use the reports of days that have ended, and, with persistence or memory, the last
//! report of each edge.

use std::sync::Arc;

use tidemap_map::{
    edge_forecast::EdgeForecasts,
    event::{Event, NewState, Observations},
    ids::StateId,
    name::{MapName, ProducerKey},
    site::SiteEdit,
    spec::MapSpec,
    topology::Topology,
    traversal::Traversal,
};
use tidemap_model::{Sample, selector::ModelSelector};

use super::{
    RoutesError, START_NANOS,
    building::{self, SPEED_M_PER_S},
};
use crate::nightly_map::NightlyMap;

/// A map that learns from traversals.
#[derive(Debug)]
pub(crate) struct Learner {
    map: NightlyMap,
    selector: ModelSelector,
    edges: EdgeForecasts,
}

impl Learner {
    /// An untrained map of the building, with default properties.
    pub(crate) fn new(selector: ModelSelector) -> Result<Self, RoutesError> {
        let spec = MapSpec {
            created_nanos: START_NANOS,
            ..MapSpec::new(MapName::new("building").map_err(RoutesError::setting)?)
        };
        let producer = ProducerKey::new("robot", "").map_err(RoutesError::setting)?;
        let mut map = NightlyMap::new(spec, producer);
        let load = building::load().map_err(RoutesError::setting)?;
        map.apply(&Event::EditSite(SiteEdit::Topology(load)))?;
        let edges = EdgeForecasts::new(Arc::new(map.view()), SPEED_M_PER_S, selector);
        Ok(Self { map, selector, edges })
    }

    /// The topology of the building.
    pub(crate) fn topology(&self) -> &Topology {
        self.map.map().site().topology()
    }

    /// The forecasts of its edges.
    pub(crate) fn edges(&self) -> &EdgeForecasts {
        &self.edges
    }

    /// Applies traversals, received when the last traversal ended.
    pub(super) fn report(&mut self, traversals: &[Traversal]) -> Result<(), RoutesError> {
        let Some(last) = traversals.last() else { return Ok(()) };
        let failures = traversals.iter().filter_map(Traversal::failure).collect();
        let mut event = Observations { failures, ..Observations::default() };
        for traversal in traversals {
            let edge = self.topology().edge_named(&traversal.edge).map_err(RoutesError::setting)?;
            for (what, value) in traversal.samples(edge.extent).map_err(RoutesError::setting)? {
                let name = traversal.edge.state(what);
                let fresh = || event.new_states.iter().find(|new| new.name == name).map(|new| new.id);
                let id = match self.map.map().find(name.as_str()).or_else(fresh) {
                    Some(id) => id,
                    None => {
                        let id = StateId((self.map.map().states() + event.new_states.len()) as u32);
                        event.new_states.push(NewState::sampled(id, name, what.kind()));
                        id
                    }
                };
                event.push(id, Sample { utc_nanos: traversal.start_nanos, offset_secs: 0, value });
            }
        }
        self.map.observe(event, traversals.len() as u64, last.end_nanos)?;
        if self.selector.is_blended() || self.selector.knows_newest() {
            self.refresh();
        }
        Ok(())
    }

    /// Learns all traversals before midnight.
    pub(super) fn midnight(&mut self, nanos: i64) -> Result<(), RoutesError> {
        self.map.update::<RoutesError>(nanos)?;
        self.refresh();
        Ok(())
    }

    fn refresh(&mut self) {
        self.edges = EdgeForecasts::new(Arc::new(self.map.view()), SPEED_M_PER_S, self.selector);
    }
}
