//! Tests edits by name: numbers stay, and refused edits change nothing.

#![allow(clippy::unwrap_used)]

use super::*;

fn name(name: &str) -> StateName {
    StateName::new(name).unwrap()
}

fn node(text: &str) -> NewNode {
    NewNode { name: name(text), pose: None, dwell_secs: None }
}

fn link(from: &str, to: &str, secs: f64) -> NewEdge {
    NewEdge { ends: EdgeEnds::link(name(from), name(to)), extent: Extent::secs(secs) }
}

fn load(nodes: &[&str], edges: &[(&str, &str, f64)], replaces: bool) -> TopologyEdit {
    let edges = edges.iter().map(|&(from, to, secs)| link(from, to, secs)).collect();
    TopologyEdit::Load { nodes: nodes.iter().map(|text| node(text)).collect(), edges, replaces }
}

fn flat() -> Topology {
    let edit = load(&["kitchen", "hall", "office"], &[("kitchen", "hall", 14.0), ("hall", "office", 21.0)], true);
    Topology::new().edited(&edit).unwrap()
}

#[test]
fn what_is_loaded_again_keeps_its_numbers() {
    let flat = flat();
    assert_eq!((flat.nodes().len(), flat.edges().len()), (3, 4));
    let office = flat.node_named("office").unwrap().id;
    let hall = flat.node_named("hall").unwrap().id;
    let way = flat.edge_between(hall, office, None).unwrap().id;
    let again = load(&["attic", "office", "hall"], &[("office", "hall", 5.0), ("attic", "hall", 9.0)], true);
    let again = flat.edited(&again).unwrap();
    assert_eq!(again.node_named("office").unwrap().id, office);
    assert_eq!(
        again.edge_between(hall, office, None).map(|edge| (edge.id, edge.extent)),
        Some((way, Extent::secs(5.0)))
    );
    assert!(again.node_named("kitchen").is_err() && again.nodes().len() == 3);
    assert_eq!(again.node_named("attic").unwrap().id, NodeId(3), "that of the kitchen is not used again");
}

#[test]
fn a_load_may_add_to_what_is_there() {
    let flat = flat();
    let more = flat.edited(&load(&["attic"], &[("attic", "hall", 9.0)], false)).unwrap();
    assert_eq!((more.nodes().len(), more.edges().len()), (4, 6));
    assert!(flat.edges().all(|edge| more.edge(edge.id) == Ok(edge)));
    let hall = flat.edited(&load(&["hall"], &[], false));
    assert_eq!(hall, Err(TopologyError::DuplicateNode("hall".to_owned())));
}

#[test]
fn a_load_with_something_wrong_is_refused_by_name() {
    let refused = |nodes: &[&str], edges: &[(&str, &str, f64)]| {
        Topology::new().edited(&load(nodes, edges, true)).unwrap_err().to_string()
    };
    assert!(refused(&["a", "b", "a"], &[]).contains("\"a\" exists already"));
    assert!(refused(&["a"], &[("a", "c", 1.0)]).contains("no node \"c\""));
    assert!(refused(&["a"], &[("a", "a", 1.0)]).contains("leads to itself"));
    for bad in [-4.0, 0.0, f64::NAN, f64::INFINITY] {
        assert!(refused(&["a", "b"], &[("a", "b", bad)]).contains("edge a/b takes"), "{bad}");
    }
    assert!(refused(&["a", "b"], &[("a", "b", 1.0), ("b", "a", 1.0)]).contains("exists already"));
    let flat = flat();
    let twice = load(&["kitchen", "hall"], &[("kitchen", "hall", 1.0), ("kitchen", "hall", 2.0)], true);
    assert!(matches!(flat.edited(&twice), Err(TopologyError::DuplicateEdge(_))));
}

#[test]
fn edits_name_nodes_and_keep_numbers() {
    let mut map = flat();
    let hall = map.node_named("hall").unwrap().id;
    let edit = |map: &mut Topology, edit: TopologyEdit| *map = map.edited(&edit).unwrap();
    edit(&mut map, TopologyEdit::RenameNode { from: name("hall"), to: name("corridor") });
    assert_eq!(map.node_named("corridor").unwrap().id, hall);
    edit(&mut map, TopologyEdit::SetExtent(link("corridor", "office", 30.0)));
    assert_eq!(map.leaving(hall).map(|edge| edge.extent.secs_at(1.0)).sum::<f64>(), 44.0);
    edit(&mut map, TopologyEdit::AddNode(node("attic")));
    edit(&mut map, TopologyEdit::AddEdge(link("attic", "office", 3.0)));
    edit(&mut map, TopologyEdit::SetNode(NewNode { dwell_secs: Some(7.0), ..node("attic") }));
    assert_eq!(map.node_named("attic").unwrap().dwell_secs, Some(7.0));
    edit(&mut map, TopologyEdit::RemoveEdge(EdgeEnds::link(name("attic"), name("office"))));
    edit(&mut map, TopologyEdit::RemoveNode(name("kitchen")));
    assert_eq!((map.nodes().len(), map.edges().len()), (3, 2));
    let wrong = map.edited(&TopologyEdit::RemoveEdge(EdgeEnds::link(name("attic"), name("office"))));
    assert_eq!(wrong, Err(TopologyError::UnknownEdge("attic/office".to_owned())));
    assert!(map.edited(&TopologyEdit::AddEdge(link("corridor", "office", 3.0))).is_err());
    let there = EdgeEnds { both_ways: false, ..EdgeEnds::link(name("corridor"), name("office")) };
    edit(&mut map, TopologyEdit::RemoveEdge(there));
    assert_eq!(map.edges().len(), 1);
}
