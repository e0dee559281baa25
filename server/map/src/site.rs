//! The site of a map: the data that people and robots give the map besides observations. It holds the charger,
//! locations, reachability, the topological map, its landmarks, failed traversals, tasks, and no-go areas.
//!
//! Invariant: a site is a function of the edits applied and their order. An edit that [`Site::check`] accepts is
//! applied whole; any other changes nothing.

use std::{collections::BTreeMap, sync::Arc};
use tidemap_grid::index::CellIndex;

use crate::{
    ids::StateId,
    landmark::{LandmarkEdit, LandmarkError, Landmarks},
    name::{InvalidName, StateName},
    no_go::{NoGoAreas, NoGoEdit, NoGoError},
    reachability::{Reachability, ReachabilityError},
    task::{TaskBook, TaskEdit, TaskError, TaskRun},
    topology::{Topology, TopologyEdit, TopologyError},
    traversal::{EdgeFailure, Failures},
};

#[cfg(test)]
mod tests;

/// Maximum number of locations of a map.
pub const LOCATIONS_MAX: usize = 10_000;

/// Maximum number of states and cells of a location.
pub(crate) const LOCATION_STATES_MAX: usize = 4_096;

/// Maximum distance of a place from the map's origin, metres.
pub const PLACE_MAX_M: f64 = 1e7;

/// States and cells that can be observed together, from one place; at least one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Location {
    /// The states, ascending.
    pub states: Vec<StateId>,
    /// Cells of the grid, ascending.
    pub cells: Vec<CellIndex>,
    /// The position of the robot when it observes them: x, y in the map's frame, metres. `None`: not given.
    pub position_m: Option<[f64; 2]>,
}

/// A change of a site.
#[derive(Clone, Debug, PartialEq)]
pub enum SiteEdit {
    /// Sets the place where the robot rests and charges: x, y in the map's frame, metres; `None` clears it.
    Charger(Option<[f64; 2]>),
    /// A location is added, or replaces the location of that name.
    SetLocation(StateName, Location),
    /// A location is removed.
    RemoveLocation(StateName),
    /// A robot reached a place that it was sent to, or did not.
    Visit {
        /// The place, x and y in the map's frame, metres.
        at_m: [f64; 2],
        /// Whether the robot reached it.
        reached: bool,
        /// The time, nanoseconds UTC.
        utc_nanos: i64,
    },
    /// The topological map is changed.
    Topology(TopologyEdit),
    /// The landmarks of a place are changed.
    Landmarks(LandmarkEdit),
    /// The tasks are changed, or a plan is kept.
    Task(TaskEdit),
    /// The no-go areas are changed.
    NoGo(NoGoEdit),
}

/// Why an edit is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidEdit {
    /// A coordinate is not a number, or too far away.
    #[error("coordinate {0} is not a number of metres between -1e7 and 1e7")]
    Coordinate(f64),
    /// A location needs states.
    #[error("location {0:?} has no states: name at least one")]
    NoStates(String),
    /// A location has too many states and cells.
    #[error("location {name:?} has {got} states, more than {max}")]
    TooManyStates {
        /// The location.
        name: String,
        /// The number given.
        got: usize,
        /// The maximum.
        max: usize,
    },
    /// A state does not exist, or is named twice.
    #[error("location {0:?} names a state that the map does not have, or one twice")]
    States(String),
    /// The map has the maximum number of locations.
    #[error("the map has the maximum of {0} locations")]
    TooManyLocations(usize),
    /// There is no such location.
    #[error("location {0:?} does not exist")]
    UnknownLocation(String),
    /// A visit is invalid.
    #[error(transparent)]
    Visit(#[from] ReachabilityError),
    /// The topological map would be invalid.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// The landmarks would be invalid.
    #[error(transparent)]
    Landmarks(#[from] LandmarkError),
    /// A task or a plan is invalid.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// A no-go area is invalid.
    #[error(transparent)]
    NoGo(#[from] NoGoError),
    /// A state of a renamed node would have the name of another state.
    #[error(
        "state {state:?} of the node would be renamed to {name:?}, but a state of that name exists: choose another name"
    )]
    StateExists {
        /// The state of the node.
        state: String,
        /// The name that another state has.
        name: String,
    },
    /// A state of a renamed node would have an invalid name.
    #[error("a state of the node cannot be renamed: {0}")]
    StateName(#[from] InvalidName),
}

/// The site: the data that people and robots give the map besides observations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Site {
    charger_m: Option<[f64; 2]>,
    locations: BTreeMap<StateName, Location>,
    reachability: Reachability,
    topology: Arc<Topology>,
    failures: Failures,
    landmarks: Arc<Landmarks>,
    tasks: TaskBook,
    no_go: NoGoAreas,
}

impl Site {
    /// The place where the robot rests: x, y in the map's frame, metres.
    pub fn charger_m(&self) -> Option<[f64; 2]> {
        self.charger_m
    }

    /// The locations, by name.
    pub fn locations(&self) -> &BTreeMap<StateName, Location> {
        &self.locations
    }

    /// How often robots have reached places.
    pub fn reachability(&self) -> &Reachability {
        &self.reachability
    }

    /// This site with stored reachability.
    pub fn with_reachability(self, reachability: Reachability) -> Site {
        Site { reachability, ..self }
    }

    /// The topological map; empty until one is loaded.
    pub fn topology(&self) -> &Arc<Topology> {
        &self.topology
    }

    /// This site with a stored topological map.
    pub fn with_topology(self, topology: Topology) -> Site {
        Site { topology: Arc::new(topology), ..self }
    }

    /// The landmarks of nodes and edges.
    pub fn landmarks(&self) -> &Arc<Landmarks> {
        &self.landmarks
    }

    /// This site with stored landmarks, which belong to its topological map.
    pub fn with_landmarks(self, landmarks: Landmarks) -> Site {
        Site { landmarks: Arc::new(landmarks), ..self }
    }

    /// The newest traversals that failed.
    pub fn failures(&self) -> &Failures {
        &self.failures
    }

    /// The areas through which nothing is planned.
    pub fn no_go(&self) -> &NoGoAreas {
        &self.no_go
    }

    /// The topological map without the edges that touch a no-go area.
    pub fn open_topology(&self) -> Arc<Topology> {
        self.no_go.without_closed(&self.topology)
    }

    /// The tasks, with the kept plans and the reports.
    pub fn tasks(&self) -> &TaskBook {
        &self.tasks
    }

    /// This site with stored tasks.
    pub fn with_tasks(self, tasks: TaskBook) -> Site {
        Site { tasks, ..self }
    }

    /// Adds reports of tasks. Unlike edits, these are part of the observations they come with.
    pub(crate) fn add_runs(&mut self, runs: &[TaskRun]) {
        self.tasks.add_runs(runs);
    }

    /// This site with the given locations.
    pub(crate) fn with_locations(self, locations: BTreeMap<StateName, Location>) -> Site {
        Site { locations, ..self }
    }

    /// This site with stored failed traversals.
    pub fn with_failures(self, failures: Failures) -> Site {
        Site { failures, ..self }
    }

    /// Adds failed traversals. Unlike edits, these are part of the observations they come with.
    pub fn add_failures(&mut self, failures: &[EdgeFailure]) {
        failures.iter().for_each(|failure| self.failures.add(failure.clone()));
    }

    /// Whether the site is empty.
    pub fn is_empty(&self) -> bool {
        *self == Site::default()
    }

    /// Checks that an edit may be applied now. `states`: number of states of the map.
    ///
    /// # Errors
    /// [`InvalidEdit`], with what is wrong.
    pub fn check(&self, edit: &SiteEdit, states: usize) -> Result<(), InvalidEdit> {
        match edit {
            SiteEdit::Charger(at) => check_place(at.as_ref()),
            SiteEdit::SetLocation(name, location) => {
                let text = || name.as_str().to_owned();
                check_place(location.position_m.as_ref())?;
                if location.states.is_empty() && location.cells.is_empty() {
                    return Err(InvalidEdit::NoStates(text()));
                }
                let (got, max) = (location.states.len() + location.cells.len(), LOCATION_STATES_MAX);
                if got > max {
                    return Err(InvalidEdit::TooManyStates { name: text(), got, max });
                }
                let ascend = location.states.is_sorted_by(|one, next| one < next)
                    && location.cells.is_sorted_by(|one, next| one < next);
                if !ascend || location.states.last().is_some_and(|last| last.0 as usize >= states) {
                    return Err(InvalidEdit::States(text()));
                }
                if self.locations.len() >= LOCATIONS_MAX && !self.locations.contains_key(name) {
                    return Err(InvalidEdit::TooManyLocations(LOCATIONS_MAX));
                }
                Ok(())
            }
            SiteEdit::RemoveLocation(name) if self.locations.contains_key(name) => Ok(()),
            SiteEdit::Visit { at_m, .. } => Ok(self.reachability.check(at_m[0], at_m[1])?),
            SiteEdit::Topology(edit) => {
                self.topology.edited(edit)?;
                if let TopologyEdit::RenameNode { from, to } = edit {
                    self.tasks.check_rename(from, to)?;
                }
                Ok(())
            }
            SiteEdit::Landmarks(edit) => Ok(self.landmarks.edited(&self.topology, edit).map(drop)?),
            SiteEdit::Task(edit) => Ok(self.tasks.check(edit)?),
            SiteEdit::NoGo(edit) => Ok(self.no_go.check(edit)?),
            SiteEdit::RemoveLocation(name) => Err(InvalidEdit::UnknownLocation(name.as_str().to_owned())),
        }
    }

    /// Applies an edit.
    ///
    /// # Errors
    /// The errors of [`Site::check`]; nothing is changed then.
    pub fn apply(&mut self, edit: &SiteEdit, states: usize) -> Result<(), InvalidEdit> {
        if let SiteEdit::Topology(edit) = edit {
            if let TopologyEdit::RenameNode { from, to } = edit {
                self.tasks.check_rename(from, to)?;
            }
            self.topology = Arc::new(self.topology.edited(edit)?);
            if let TopologyEdit::RenameNode { from, to } = edit {
                self.failures.rename_node(from, to);
                self.tasks.rename_node(from, to);
            } else if !self.landmarks.is_empty() {
                Arc::make_mut(&mut self.landmarks).keep_places_of(&self.topology);
            }
            return Ok(());
        }
        if let SiteEdit::Landmarks(edit) = edit {
            self.landmarks = Arc::new(self.landmarks.edited(&self.topology, edit)?);
            return Ok(());
        }
        if let SiteEdit::NoGo(edit) = edit {
            return Ok(self.no_go.apply(edit)?);
        }
        self.check(edit, states)?;
        match edit {
            SiteEdit::Charger(at) => self.charger_m = *at,
            SiteEdit::SetLocation(name, location) => {
                self.locations.insert(name.clone(), location.clone());
            }
            SiteEdit::RemoveLocation(name) => {
                self.locations.remove(name);
            }
            SiteEdit::Visit { at_m, reached, utc_nanos } => {
                self.reachability.report(at_m[0], at_m[1], *reached, *utc_nanos)?;
            }
            SiteEdit::Task(edit) => self.tasks.apply(edit)?,
            // These edits are applied above.
            SiteEdit::Topology(_) | SiteEdit::Landmarks(_) | SiteEdit::NoGo(_) => {}
        }
        Ok(())
    }
}

fn check_place(at: Option<&[f64; 2]>) -> Result<(), InvalidEdit> {
    let is_far = |along: &&f64| !(-PLACE_MAX_M..=PLACE_MAX_M).contains(*along);
    at.into_iter().flatten().find(is_far).map_or(Ok(()), |&along| Err(InvalidEdit::Coordinate(along)))
}
