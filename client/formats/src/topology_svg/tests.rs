//! The positions, labels and colours of drawings.

use super::*;

fn node(name: &str, at_m: Option<[f64; 2]>, probability: Option<f64>) -> PictureNode {
    PictureNode { name: name.to_owned(), at_m, probability, step: None }
}

fn edge(from: usize, to: usize, success: Option<f64>) -> PictureEdge {
    PictureEdge { from, to, length: 10.0, success, is_on_path: false }
}

#[test]
fn nodes_are_drawn_at_their_positions_with_their_probabilities() -> Result<(), TopologyPictureError> {
    let nodes = vec![
        node("a<b>&\"c\"", Some([0.0, 0.0]), Some(0.25)),
        node("north", Some([0.0, 10.0]), None),
        PictureNode { step: Some(3), ..node("east", Some([10.0, 0.0]), Some(1.0)) },
    ];
    let route = PictureEdge { is_on_path: true, ..edge(0, 2, Some(0.5)) };
    let picture = TopologyPicture { title: "at <noon>".to_owned(), nodes, edges: vec![edge(0, 1, Some(0.9)), route] };
    let svg = write(&picture)?;
    assert_eq!((svg.matches("<circle").count(), svg.matches("<line").count()), (3, 2));
    assert!(svg.contains("a&lt;b&gt;&amp;&quot;c&quot;") && svg.contains("at &lt;noon&gt;"));
    assert!(
        svg.contains("cx=\"70.0\" cy=\"970.0\"") && svg.contains("cx=\"70.0\" cy=\"70.0\""),
        "north is above: {svg}"
    );
    assert!(svg.contains(">25</text>") && svg.contains(">3</text>") && svg.contains("east 100%"));
    assert!(svg.contains(&format!("stroke=\"{PATH}\" stroke-width=\"4\"")));
    assert_eq!(svg, write(&picture)?, "the same bytes");
    Ok(())
}

#[test]
fn nodes_without_positions_are_laid_out_with_connected_ones_close() -> Result<(), TopologyPictureError> {
    // A chain of five, with edges in one direction or both, and an unconnected node.
    let nodes: Vec<PictureNode> = (0..6).map(|i| node(&i.to_string(), None, None)).collect();
    let edges: Vec<PictureEdge> = (0..4).map(|i| edge(i, i + 1, None)).chain([edge(3, 2, None)]).collect();
    let places = layout::places(&nodes, &edges)?;
    let far = |a: usize, b: usize| (places[a][0] - places[b][0]).hypot(places[a][1] - places[b][1]);
    for i in 0..4 {
        assert!((far(i, i + 1) - 1.0).abs() < 0.3, "{i}: {}", far(i, i + 1));
    }
    assert!(far(0, 4) > 3.0 && (0..5).all(|i| far(i, 5) > 1.0), "{places:?}");
    Ok(())
}

#[test]
fn maps_that_cannot_be_drawn_are_refused() {
    assert_eq!(write(&TopologyPicture::default()), Err(TopologyPictureError::Empty));
    let nodes: Vec<PictureNode> = (0..401).map(|i| node(&i.to_string(), None, None)).collect();
    let picture = TopologyPicture { nodes, ..TopologyPicture::default() };
    assert_eq!(write(&picture), Err(TopologyPictureError::TooMany { without: 401, nodes: 401 }));
    let one = TopologyPicture { nodes: vec![node("alone", None, None)], ..TopologyPicture::default() };
    assert!(write(&one).is_ok_and(|svg| !svg.contains("NaN") && !svg.contains("inf")));
}

#[test]
fn colours_numbers_and_scale_are_explained() -> Result<(), TopologyPictureError> {
    let nodes = vec![node("A", Some([0.0, 0.0]), None), node("B", Some([0.0, 10.0]), None)];
    let picture = |is_on_path| TopologyPicture {
        nodes: nodes.clone(),
        edges: vec![PictureEdge { is_on_path, ..edge(0, 1, Some(0.5)) }],
        ..TopologyPicture::default()
    };
    let svg = write(&picture(false))?;
    for words in ["node, number in %", "edge, number in %", "grey: not observed yet", "2 m"] {
        assert!(svg.contains(words), "{words}: {svg}");
    }
    assert!(!svg.contains("planned way") && write(&picture(true))?.contains("planned way"));
    let laid_out = TopologyPicture { nodes: vec![node("A", None, None)], ..TopologyPicture::default() };
    assert!(!write(&laid_out)?.contains(" m<"), "a layout has no scale");
    Ok(())
}

#[test]
fn a_name_stands_where_no_edge_leaves() {
    // The middle one has edges to all sides but the left.
    let places = [[0.0, 0.0], [0.0, 100.0], [100.0, 0.0], [0.0, -100.0]];
    let edges = [edge(0, 1, None), edge(2, 0, None), edge(0, 3, None)];
    assert_eq!(free_side(0, &edges, &places).1, "end");
    assert_eq!(free_side(2, &edges, &places), ([0.0, DISC + 14.0], "middle"));
    assert_eq!(free_side(1, &edges, &places).0, [0.0, DISC + 14.0], "the edge goes up, and the name stands below");
}
