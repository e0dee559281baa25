//! Lists where a map names states besides the states themselves, their observations and their history: one row for each
//! place in the map's site, and for the edits that put it there.
//!
//! A location, a node, an edge and a task are objects of their own, which people have named; they stay, and so do their
//! names. Their data about an erased state is removed.
//!
//! Invariant: an erasure applies all rows. After it, no row holds the name or the id of an erased state.

use super::StateErasure;
use crate::{
    name::{EdgeState, StateName},
    site::{Location, Site, SiteEdit},
    task::{KeptPlan, KeptStep, KeptWork, RobotTask, TaskEdit, TaskRun, TaskRuns},
    traversal::{EdgeFailure, Failures},
};

/// A place that names states.
pub(super) struct Reference {
    /// Returns the site without the place's data about erased states.
    pub(super) site: fn(&StateErasure, Site) -> Site,
    /// Returns an edit without data about erased states.
    pub(super) edit: fn(&StateErasure, SiteEdit) -> SiteEdit,
}

/// All places. Add a row here for each new place that names states.
pub(super) const REFERENCES: [Reference; 5] = [
    // The row for locations.
    Reference { site: locations, edit: as_it_is },
    // The row for failed traversals.
    Reference { site: failures, edit: as_it_is },
    // The row for reports of tasks.
    Reference { site: runs, edit: as_it_is },
    // The row for states that multiply the value of tasks.
    Reference { site: tasks, edit: edited_task },
    // The row for kept plans.
    Reference { site: plans, edit: edited_plan },
];

fn as_it_is(_: &StateErasure, edit: SiteEdit) -> SiteEdit {
    edit
}

fn locations(erasure: &StateErasure, site: Site) -> Site {
    let left = site.locations().iter();
    let left = left.filter_map(|(name, location)| Some((name.clone(), erasure.location(location)?)));
    let left = left.collect();
    site.with_locations(left)
}

fn failures(erasure: &StateErasure, site: Site) -> Site {
    let is_selected = |failure: &EdgeFailure| {
        let failed = erasure.part.as_ref().map(|part| &part.decision.failed);
        failed.is_some_and(|f| f.contains(&(failure.edge.state(EdgeState::Success), failure.start_nanos)))
    };
    let mut left = Failures::default();
    let of_site = site.failures().oldest_first();
    let kept = of_site.filter(|failure| !erasure.is_of_erased(failure) && !is_selected(failure));
    kept.for_each(|failure| left.add(failure.clone()));
    site.with_failures(left)
}

fn runs(erasure: &StateErasure, site: Site) -> Site {
    let selected = erasure.part.as_ref().map(|part| &part.decision.failed);
    let is_left = |run: &TaskRun| {
        let (name, start) = (run.name.state(), run.start_nanos);
        !erasure.is_current_name(&name) && !selected.is_some_and(|s| s.contains(&(name, start)))
    };
    let mut left = TaskRuns::default();
    site.tasks().runs().oldest_first().filter(|run| is_left(run)).for_each(|run| left.add(run.clone()));
    let tasks = site.tasks().clone().with_runs(left);
    site.with_tasks(tasks)
}

/// A task; if its value depends on an erased state, it gets its plain value.
fn task(erasure: &StateErasure, task: RobotTask) -> RobotTask {
    let value_state = task.value_state.filter(|state| !erasure.is_erased_name(state));
    RobotTask { value_state, ..task }
}

fn tasks(erasure: &StateErasure, site: Site) -> Site {
    let book = site.tasks().clone().with_tasks(|known| task(erasure, known));
    site.with_tasks(book)
}

fn edited_task(erasure: &StateErasure, edit: SiteEdit) -> SiteEdit {
    match edit {
        SiteEdit::Task(TaskEdit::Set(set)) => SiteEdit::Task(TaskEdit::Set(task(erasure, set))),
        edit => edit,
    }
}

/// A plan without the steps that observe an erased state by its name, or do a task whose reports it counts.
fn plan(erasure: &StateErasure, plan: KeptPlan) -> KeptPlan {
    let is_left = |step: &KeptStep| match &step.work {
        KeptWork::Task { name, .. } => !erasure.is_erased_name(&name.state()),
        KeptWork::Explore { place, .. } => !erasure.is_erased_place(place),
    };
    KeptPlan { steps: plan.steps.into_iter().filter(is_left).collect(), ..plan }
}

fn plans(erasure: &StateErasure, site: Site) -> Site {
    let book = site.tasks().clone().with_plans(|known| plan(erasure, known));
    site.with_tasks(book)
}

fn edited_plan(erasure: &StateErasure, edit: SiteEdit) -> SiteEdit {
    match edit {
        SiteEdit::Task(TaskEdit::KeepPlan(kept)) => SiteEdit::Task(TaskEdit::KeepPlan(plan(erasure, kept))),
        edit => edit,
    }
}

impl StateErasure {
    /// A location without the states; `None` where nothing else is observed there.
    pub(super) fn location(&self, location: &Location) -> Option<Location> {
        let states = self.ids(&location.states);
        let is_left = !states.is_empty() || !location.cells.is_empty();
        is_left.then(|| Location { states, ..location.clone() })
    }

    pub(super) fn is_of_erased(&self, failure: &EdgeFailure) -> bool {
        let of_edge = [EdgeState::Success, EdgeState::Speed, EdgeState::Pace].map(|what| failure.edge.state(what));
        of_edge.iter().any(|name| self.is_current_name(name))
    }

    /// Whether an erased state has this name now.
    pub(super) fn is_current_name(&self, name: &StateName) -> bool {
        self.names.values().any(|known| known == name)
    }

    /// Whether an erased state has this name, now or at another log position.
    fn is_erased_name(&self, name: &StateName) -> bool {
        self.all_names.contains(name)
    }

    /// Whether a place that is explored has the name of an erased state, or of the whole of which an erased state is a
    /// part.
    fn is_erased_place(&self, place: &str) -> bool {
        self.all_names
            .iter()
            .map(StateName::as_str)
            .any(|name| name == place || name.rsplit_once('/').is_some_and(|(whole, _)| whole == place))
    }
}
