//! Tests that states are renamed with their node.

use super::*;
use crate::{
    site::SiteEdit,
    topology::{NewNode, TopologyEdit},
};

fn name(text: &str) -> StateName {
    StateName::observed(text).expect("valid")
}

fn edit(edit: TopologyEdit) -> Event {
    Event::EditSite(SiteEdit::Topology(edit))
}

fn node(text: &str) -> Event {
    edit(TopologyEdit::AddNode(NewNode { name: name(text), pose: None, dwell_secs: None }))
}

#[test]
fn what_was_learned_of_a_node_is_found_under_its_new_name() {
    let mut map = LiveMap::new(spec());
    apply(&mut map, &node("lobby"));
    for (id, state) in ["lobby", "door", "node/lobby/anna"].into_iter().enumerate() {
        let new = NewState::sampled(StateId(id as u32), name(state), StateShape::default());
        apply(&mut map, &Event::AddState(new));
    }
    let observed = event(&map, &[(0, HOUR, 1.0), (1, HOUR, 0.0), (2, HOUR, 1.0)]);
    apply(&mut map, &observed);
    let before = map.publish();
    apply(&mut map, &edit(TopologyEdit::RenameNode { from: name("lobby"), to: name("hall") }));
    let view = map.publish();
    let found = ["hall", "node/hall", "node/hall/anna", "door", "lobby", "node/lobby/anna"].map(|name| view.find(name));
    assert_eq!(found, [Some(StateId(0)), Some(StateId(0)), Some(StateId(2)), Some(StateId(1)), None, None]);
    assert_eq!(before.find("lobby"), Some(StateId(0)), "an old view stays as it was");
    assert_eq!(view.live(StateId(2)), before.live(StateId(2)));
    let snapshot = update(&mut map, None);
    let restored = LiveMap::restore(spec(), snapshot);
    assert_eq!(restored.find("node/hall/anna"), Some(StateId(2)));
    // A name that is free again can be given to a new state.
    let new = NewState::sampled(StateId(3), name("lobby"), StateShape::default());
    apply(&mut map, &Event::AddState(new));
    assert_eq!(map.find("lobby"), Some(StateId(3)));
}

#[test]
fn a_state_whose_new_name_is_taken_keeps_its_own() {
    let mut map = LiveMap::new(spec());
    apply(&mut map, &node("lobby"));
    for (id, state) in ["lobby", "hall", "node/lobby/anna"].into_iter().enumerate() {
        let new = NewState::sampled(StateId(id as u32), name(state), StateShape::default());
        apply(&mut map, &Event::AddState(new));
    }
    apply(&mut map, &edit(TopologyEdit::RenameNode { from: name("lobby"), to: name("hall") }));
    let found = ["lobby", "hall", "node/hall/anna"].map(|name| map.find(name));
    assert_eq!(found, [Some(StateId(0)), Some(StateId(1)), Some(StateId(2))]);
}
