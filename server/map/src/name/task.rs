//! Names of tasks, and of the states that learn from their reports.
//!
//! Invariant: both parts of such a name are plain names, without `/`, so that a state's name identifies its task.

use std::fmt;

use super::{InvalidName, StateName, shown};

/// First part of the states' names.
const PREFIX: &str = "task";

/// The name of a task: its kind, and the node where it is done. Neither need exist.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TaskName {
    /// The work that is done.
    pub kind: StateName,
    /// The node of the topological map where it is done.
    pub node: StateName,
}

impl TaskName {
    /// Checks both names.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn new(kind: &str, node: &str) -> Result<Self, InvalidName> {
        Ok(Self { kind: StateName::new(kind)?, node: StateName::new(node)? })
    }

    /// Checks a whole name, `KIND/NODE`.
    ///
    /// # Errors
    /// [`InvalidName`]; [`InvalidName::Slash`] where there are fewer or more parts.
    pub fn parse(name: &str) -> Result<Self, InvalidName> {
        let (kind, node) = name.split_once('/').ok_or_else(|| InvalidName::Slash(shown(name)))?;
        Self::new(kind, node)
    }

    /// Name of the task's state: whether the task succeeds, a probability, `task/KIND/NODE`.
    #[must_use]
    pub fn state(&self) -> StateName {
        StateName(format!("{PREFIX}/{self}").into())
    }
}

impl fmt::Display for TaskName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind, self.node)
    }
}

impl StateName {
    /// If this is the name of a task's state: the task.
    #[must_use]
    pub fn as_task(&self) -> Option<TaskName> {
        split_task(&self.0).and_then(|task| TaskName::parse(task).ok())
    }
}

/// The rest of a name that begins like the name of a task's state. An axis of a vector, `task/x`, is not such a name.
pub(super) fn split_task(name: &str) -> Option<&str> {
    let (prefix, task) = name.split_once('/')?;
    (prefix == PREFIX && task.contains('/')).then_some(task)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_task_and_its_state_name_each_other() {
        let task = TaskName::new("clean", "hall").unwrap();
        assert_eq!(task.state().as_str(), "task/clean/hall");
        assert_eq!(task.state().as_task(), Some(task.clone()));
        assert_eq!(StateName::stored("task/clean/hall"), Ok(task.state()));
        assert_eq!(TaskName::parse("clean/hall"), Ok(task));
    }

    #[test]
    fn other_names_are_no_tasks() {
        for wrong in ["clean", "clean/", "/hall", "clean/hall/x", ""] {
            assert!(TaskName::parse(wrong).is_err(), "{wrong:?}");
        }
        for other in ["task/x", "task", "edge/task/hall"] {
            assert_eq!(StateName::stored(other).unwrap().as_task(), None, "{other}");
        }
        assert!(StateName::stored("task/a/b/c").is_err());
        // Only reports of tasks observe such a state.
        assert!(StateName::observed("task/clean/hall").is_err());
    }

    #[test]
    fn a_renamed_node_renames_the_state() {
        let state = TaskName::new("clean", "hall").unwrap().state();
        let lobby = StateName::new("lobby").unwrap();
        let renamed = state.with_node_renamed("hall", &lobby).unwrap().unwrap();
        assert_eq!(renamed.as_str(), "task/clean/lobby");
        assert_eq!(state.with_node_renamed("clean", &lobby), None);
    }
}
