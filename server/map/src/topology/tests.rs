//! Tests edits and refusals of topological maps, and compares shortest times with a naive oracle.

#![allow(clippy::unwrap_used)]

use proptest::prelude::*;

use super::*;

fn name(name: &str) -> StateName {
    StateName::new(name).unwrap()
}

/// Three rooms in a row.
fn flat() -> (Topology, [NodeId; 3]) {
    let mut flat = Topology::new();
    let nodes = ["kitchen", "hall", "office"].map(|room| flat.add_node(name(room), None, None).unwrap());
    flat.link(nodes[0], nodes[1], Extent::secs(14.0)).unwrap();
    flat.link(nodes[1], nodes[2], Extent::secs(21.0)).unwrap();
    (flat, nodes)
}

fn times(topology: &Topology) -> Vec<f64> {
    Roads::new(topology, |edge| Some(edge.extent.secs_at(0.5))).unwrap().all_pairs().unwrap()
}

#[test]
fn names_lead_to_nodes_and_their_edges() {
    let (flat, [kitchen, hall, office]) = flat();
    assert_eq!(flat.node_named("hall").unwrap().id, hall);
    let mut neighbours: Vec<NodeId> = flat.leaving(hall).map(|edge| edge.to).collect();
    neighbours.sort();
    assert_eq!(neighbours, [kitchen, office]);
    assert_eq!(flat.at(hall).count(), 4);
    assert_eq!(flat.edge_name(flat.edge_between(hall, office, None).unwrap()), "hall/office");
    assert_eq!(times(&flat), [0.0, 14.0, 35.0, 14.0, 0.0, 21.0, 35.0, 21.0, 0.0]);
}

#[test]
fn what_is_wrong_is_named() {
    let (mut flat, [kitchen, hall, office]) = flat();
    let before = flat.clone();
    let text = |error: TopologyError| error.to_string();
    assert!(text(flat.node_named("attic").unwrap_err()).contains("attic"));
    assert!(text(flat.add_node(name("hall"), None, None).unwrap_err()).contains("hall"));
    assert_eq!(flat.add_edge(hall, NodeId(9), None, Extent::secs(1.0)), Err(TopologyError::UnknownNodeId(9)));
    assert_eq!(flat.add_edge(hall, hall, None, Extent::secs(1.0)), Err(TopologyError::ToItself("hall".into())));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e300] {
        let duration = flat.add_edge(kitchen, office, None, Extent::secs(bad));
        assert!(matches!(duration, Err(TopologyError::Duration { .. })), "{bad}");
        let length = flat.add_edge(kitchen, office, None, Extent::metres(bad));
        assert!(matches!(length, Err(TopologyError::Length { .. })), "{bad}");
        assert!(matches!(flat.set_extent(EdgeId(0), Extent::secs(bad)), Err(TopologyError::Duration { .. })));
    }
    let neither = flat.add_edge(kitchen, office, None, Extent { length_m: None, nominal_secs: None });
    assert_eq!(neither, Err(TopologyError::NoExtent { edge: "kitchen/office".into() }));
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(flat.set_node(hall, None, Some(bad)), Err(TopologyError::Dwell { .. })), "{bad}");
    }
    let pose = NodePose { x_m: f64::NAN, y_m: 0.0, yaw_rad: 0.0 };
    assert!(matches!(flat.add_node(name("attic"), Some(pose), None), Err(TopologyError::Pose { .. })));
    assert!(matches!(flat.link(kitchen, hall, Extent::secs(1.0)), Err(TopologyError::DuplicateEdge(_))));
    assert!(matches!(flat.rename_node(kitchen, name("hall")), Err(TopologyError::DuplicateNode(_))));
    assert_eq!(flat, before, "a refused edit changes nothing");
}

#[test]
fn a_link_of_which_one_way_exists_adds_nothing() {
    let (mut flat, [kitchen, _, office]) = flat();
    flat.add_edge(office, kitchen, None, Extent::metres(3.0)).unwrap();
    let edges: Vec<Edge> = flat.edges().cloned().collect();
    assert!(matches!(flat.link(kitchen, office, Extent::metres(3.0)), Err(TopologyError::DuplicateEdge(_))));
    assert_eq!(flat.edges().cloned().collect::<Vec<_>>(), edges);
}

#[test]
fn edges_between_the_same_nodes_differ_by_action() {
    let (mut flat, [kitchen, hall, _]) = flat();
    let through_door = flat.add_edge(kitchen, hall, Some(name("door_passing")), Extent::metres(2.0)).unwrap();
    assert_eq!(flat.edge_name(flat.edge(through_door).unwrap()), "kitchen/hall/door_passing");
    assert!(matches!(flat.rename_edge(through_door, None), Err(TopologyError::DuplicateEdge(_))));
    flat.rename_edge(through_door, Some(name("door"))).unwrap();
    assert!(flat.edge_between(kitchen, hall, Some(&name("door"))).is_some());
    assert!(flat.edge_between(kitchen, hall, Some(&name("door_passing"))).is_none());
    // The time of 2 m at 0.5 m/s is 4 s; the shorter of the two edges counts.
    assert_eq!(times(&flat)[1], 4.0);
}

#[test]
fn numbers_survive_changes_and_are_never_reused() {
    let (mut flat, [kitchen, hall, office]) = flat();
    let edge = flat.edge_between(hall, office, None).unwrap().id;
    flat.set_extent(edge, Extent::metres(7.0)).unwrap();
    flat.rename_node(office, name("study")).unwrap();
    assert_eq!(flat.edge(edge).unwrap().extent.length_m, Some(7.0));
    assert_eq!(flat.node_named("study").unwrap().id, office);
    assert!(flat.node_named("office").is_err());

    let gone = flat.remove_node(hall).unwrap();
    assert_eq!(gone.len(), 4);
    assert_eq!(flat.edges().len(), 0);
    assert!(times(&flat)[1].is_infinite());
    let again = flat.add_node(name("hall"), None, None).unwrap();
    assert!(again > office && again != hall && again != kitchen);
    let (there, back) = flat.link(kitchen, again, Extent::secs(1.0)).unwrap();
    assert!(gone.iter().all(|old| old.id < there && old.id < back));
    let restored = Topology::from_parts(flat.to_parts()).unwrap();
    assert_eq!(restored, flat);
}

#[test]
fn parts_that_break_a_rule_are_refused() {
    let (flat, [_, hall, _]) = flat();
    let broken = |change: &dyn Fn(&mut TopologyParts)| {
        let mut parts = flat.to_parts();
        change(&mut parts);
        Topology::from_parts(parts)
    };
    let number = |result| matches!(result, Err(TopologyError::Number { .. }));
    assert!(number(broken(&|parts| parts.next_node = 2)));
    assert!(number(broken(&|parts| parts.next_edge = 0)));
    assert!(number(broken(&|parts| parts.nodes[2].id = hall)));
    assert!(matches!(broken(&|parts| parts.nodes[2].name = name("hall")), Err(TopologyError::DuplicateNode(_))));
    assert!(matches!(
        broken(&|parts| {
            parts.nodes.remove(0);
        }),
        Err(TopologyError::UnknownNodeId(0))
    ));
    assert!(broken(&|_| ()).is_ok());
}

#[test]
fn a_closed_edge_is_gone_around_and_a_time_that_is_none_is_refused() {
    let (mut flat, [kitchen, _, office]) = flat();
    flat.link(kitchen, office, Extent::secs(100.0)).unwrap();
    let closed = flat.edge_between(kitchen, office, None).unwrap().id;
    let roads = Roads::new(&flat, |edge| (edge.id.0 != 0).then_some(edge.extent.secs_at(1.0))).unwrap();
    let mut shortest = ShortestTimes::default();
    shortest.from(&roads, 0);
    assert_eq!(shortest.secs(), [0.0, 121.0, 100.0]);
    let way: Vec<(usize, f64)> = shortest.way_to(1).iter().map(|stop| (stop.node, stop.secs)).collect();
    assert_eq!(way, [(2, 100.0), (1, 121.0)]);
    let bad = Roads::new(&flat, |edge| Some(if edge.id == closed { f64::NAN } else { 1.0 }));
    assert!(matches!(bad, Err(RoadsError::Duration { ref edge, .. }) if edge == "kitchen/office"));
}

#[test]
fn all_pairs_of_a_large_map_are_refused() {
    let mut large = Topology::new();
    for node in 0..5_001 {
        large.add_node(name(&format!("n{node}")), None, None).unwrap();
    }
    let roads = Roads::new(&large, |_| None).unwrap();
    assert_eq!(roads.all_pairs(), Err(RoadsError::TooManyPairs { found: 5_001 }));
}

proptest! {
    /// Compares the times with Floyd and Warshall's three loops, directions and parallel edges included.
    #[test]
    fn shortest_times_agree_with_the_naive_ones(
        count in 1..9_usize,
        edges in prop::collection::vec((0..9_usize, 0..9_usize, 0..3_u8, 1..50_u32), 0..40),
    ) {
        let mut map = Topology::new();
        let nodes: Vec<NodeId> = (0..count).map(|i| map.add_node(name(&format!("n{i}")), None, None).unwrap()).collect();
        let mut naive = vec![vec![f64::INFINITY; count]; count];
        for (node, row) in naive.iter_mut().enumerate() {
            row[node] = 0.0;
        }
        for (from, to, action, secs) in edges {
            let (from, to, secs) = (from % count, to % count, f64::from(secs));
            if map.add_edge(nodes[from], nodes[to], Some(name(&format!("a{action}"))), Extent::secs(secs)).is_ok() {
                naive[from][to] = naive[from][to].min(secs);
            }
        }
        for via in 0..count {
            for from in 0..count {
                for to in 0..count {
                    naive[from][to] = naive[from][to].min(naive[from][via] + naive[via][to]);
                }
            }
        }
        prop_assert_eq!(times(&map), naive.concat());
        prop_assert_eq!(Topology::from_parts(map.to_parts()), Ok(map));
    }
}
