//! Renames the states of a renamed node, so that their learned data is found under the new name.
//!
//! Invariant: a state keeps its name if its new name is taken; [`renamed_states`] lists these states beforehand.

use super::LiveMap;
use crate::{
    ids::StateId,
    name::{InvalidName, StateName},
    site::SiteEdit,
    topology::TopologyEdit,
};

/// The new name of a state, or the reason why the state keeps its old name.
pub type Renamed = Result<StateName, InvalidName>;

/// The states that an edit renames: the number of each, and its new name. Only an edit that renames a node renames
/// states.
pub fn renamed_states<'a, Id>(
    edit: &SiteEdit,
    states: impl Iterator<Item = (Id, &'a StateName)>,
) -> Vec<(Id, Renamed)> {
    let SiteEdit::Topology(TopologyEdit::RenameNode { from, to }) = edit else { return Vec::new() };
    let renamed = |(id, name): (Id, &StateName)| Some((id, name.with_node_renamed(from.as_str(), to)?));
    states.filter_map(renamed).collect()
}

impl LiveMap {
    /// All states, by their numbers.
    pub fn names(&self) -> impl Iterator<Item = (StateId, &StateName)> {
        (0..).map(StateId).zip(self.directory.iter().map(|info| &info.name))
    }

    /// The name of a state.
    pub fn name(&self, id: StateId) -> Option<&StateName> {
        self.directory.info(id).map(|info| &info.name)
    }

    pub(super) fn rename_states(&mut self, edit: &SiteEdit) {
        for (id, name) in renamed_states(edit, self.names()) {
            if let Ok(name) = name {
                self.directory.rename(id, name);
            }
        }
    }
}
