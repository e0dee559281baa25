//! Trees made by hand, and random trees written in both forms.
//!
//! Invariant: the writer here follows the description of the format only, and shares no code with the reader.

use proptest::prelude::*;

use super::{
    super::cuts::{every_cut_is_refused, no_change_panics},
    *,
};

/// A tree as in OctoMap.
#[derive(Clone, Debug)]
enum Node {
    Leaf(f32),
    Inner(Vec<(u8, Node)>),
}

fn file(start: &str, id: &str, nodes: u64, data: &[u8]) -> Vec<u8> {
    let header = format!("{start}\n# (a comment)\n#\nid {id}\nsize {nodes}\nres 0.1\ndata\n");
    [header.as_bytes(), data].concat()
}

fn count(node: &Node) -> u64 {
    match node {
        Node::Leaf(_) => 1,
        Node::Inner(children) => 1 + children.iter().map(|(_, child)| count(child)).sum::<u64>(),
    }
}

fn put_full(node: &Node, colour: &[u8], out: &mut Vec<u8>) {
    let (log_odds, children): (f32, &[(u8, Node)]) = match node {
        Node::Leaf(log_odds) => (*log_odds, &[]),
        Node::Inner(children) => (0.25, children),
    };
    out.extend(log_odds.to_le_bytes());
    out.extend(colour);
    out.push(children.iter().map(|(index, _)| 1 << index).sum());
    children.iter().for_each(|(_, child)| put_full(child, colour, out));
}

fn put_binary(node: &Node, out: &mut Vec<u8>) {
    let Node::Inner(children) = node else { return };
    let bits = children.iter().map(|(index, child)| {
        let kind = match child {
            Node::Leaf(log_odds) if *log_odds < 0.0 => 1_u16,
            Node::Leaf(_) => 2,
            Node::Inner(_) => 3,
        };
        kind << (2 * index)
    });
    out.extend(bits.sum::<u16>().to_le_bytes());
    children.iter().for_each(|(_, child)| put_binary(child, out));
}

fn full(id: &str, node: &Node) -> Vec<u8> {
    let mut data = Vec::new();
    put_full(node, if id == "ColorOcTree" { &[1, 2, 3] } else { &[] }, &mut data);
    file(FULL_START, id, count(node), &data)
}

fn binary(node: &Node) -> Vec<u8> {
    let mut data = Vec::new();
    put_binary(node, &mut data);
    file(BINARY_START, "OcTree", count(node), &data)
}

/// The leaves, by another algorithm than the reader's: by halving a cube with signed corners.
fn leaves(node: &Node, min: [i32; 3], side: i32, out: &mut Vec<([i32; 3], i32, f32)>) {
    match node {
        Node::Leaf(log_odds) => out.push((min, side, *log_odds)),
        Node::Inner(children) => {
            for (index, child) in children {
                let upper = |bit: u8| if index & bit == 0 { 0 } else { side / 2 };
                leaves(child, [min[0] + upper(1), min[1] + upper(2), min[2] + upper(4)], side / 2, out);
            }
        }
    }
}

fn chain(path: &[u8], end: Node) -> Node {
    path.iter().rev().fold(end, |node, &index| Node::Inner(vec![(index, node)]))
}

/// The cell at the origin and the one below it, and a large free cube.
fn small() -> Node {
    Node::Inner(vec![
        (0, chain(&[7; 15], Node::Leaf(1.5))),
        (1, Node::Leaf(-0.4)),
        (7, chain(&[0; 15], Node::Leaf(-1.0))),
    ])
}

fn sorted(map: &OctoMap) -> Vec<([i32; 3], i32, f32)> {
    let mut leaves: Vec<_> =
        map.leaves.iter().map(|leaf| (leaf.min_cell, leaf.size_cells as i32, leaf.log_odds)).collect();
    leaves.sort_by_key(|leaf| leaf.0);
    leaves
}

fn refused(file: impl AsRef<[u8]>, text: &str) {
    match read(file.as_ref()) {
        Ok(map) => panic!("{text}: {map:?}"),
        Err(error) => assert!(error.to_string().contains(text), "{error:?} should say {text}: {error}"),
    }
}

#[test]
fn the_origin_is_between_the_cells_minus_one_and_zero() -> Result<(), FormatError> {
    let expected = [([-32768, -32768, -32768], 1), ([-1, -1, -1], 1), ([0, -32768, -32768], 32768), ([0, 0, 0], 1)];
    for file in [full("OcTree", &small()), full("ColorOcTree", &small()), full("1", &small()), binary(&small())] {
        let map = read(&file)?;
        assert_eq!(map.resolution_m, 0.1);
        let found: Vec<_> = sorted(&map).into_iter().map(|(min, side, _)| (min, side)).collect();
        assert_eq!(found, expected[1..]);
    }
    let corner = chain(&[0; 16], Node::Leaf(0.0));
    assert_eq!(
        read(&binary(&corner))?.leaves,
        [Leaf { min_cell: expected[0].0, size_cells: 1, occupied: true, log_odds: OCCUPIED_LOG_ODDS }]
    );
    Ok(())
}

#[test]
fn bytes_have_the_meaning_of_the_format() -> Result<(), FormatError> {
    // Child 1 free, child 2 occupied, child 7 with children, of which child 0 is occupied.
    let data = [0b0010_0100, 0b1100_0000, 0b0000_0010, 0];
    let map = read(&file(BINARY_START, "OcTree", 5, &data))?;
    let half = 32768;
    assert_eq!(
        sorted(&map),
        [
            ([-half, 0, -half], half, OCCUPIED_LOG_ODDS),
            ([0, -half, -half], half, FREE_LOG_ODDS),
            ([0, 0, 0], half / 2, OCCUPIED_LOG_ODDS),
        ]
    );
    // The root with child 4, above the plane z = 0; log-odds -0.5.
    let data = [0, 0, 0, 0, 0b0001_0000, 0, 0, 0, 0xbf, 0];
    let map = read(&file(FULL_START, "OcTree", 2, &data))?;
    assert_eq!(map.leaves, [Leaf { min_cell: [-half, -half, 0], size_cells: 32768, occupied: false, log_odds: -0.5 }]);
    Ok(())
}

#[test]
fn empty_trees_are_empty() -> Result<(), FormatError> {
    assert_eq!(read(&file(BINARY_START, "OcTree", 0, &[]))?.leaves, []);
    assert_eq!(read(&file(FULL_START, "OcTree", 0, &[]))?.leaves, []);
    assert_eq!(read(&file(BINARY_START, "OcTree", 1, &[0, 0]))?.leaves, []);
    assert_eq!(read(&full("OcTree", &Node::Leaf(-1.0)))?.leaves.len(), 1);
    Ok(())
}

#[test]
fn errors_name_the_place_and_what_would_be_right() {
    refused("", "the file is empty");
    refused("# .PCD v0.7\n", "the start of the file is \"# .PCD v0.7\"");
    let text = |from: &str, to: &str| {
        let whole = String::from_utf8(file(FULL_START, "OcTree", 0, &[])).expect("text");
        assert!(whole.contains(from));
        whole.replace(from, to)
    };
    refused(text("id OcTree", "id OcTreeStamped"), "line 4: id is \"OcTreeStamped\"");
    refused(text("id OcTree\n", ""), "id is missing");
    refused(text("size 0", "size -1"), "line 5: size is \"-1\"");
    refused(text("res 0.1", "res 0"), "line 6: res is \"0\"");
    refused(text("res 0.1", "res nan"), "line 6: res is \"nan\"");
    refused(text("data\n", ""), "data is missing");
    refused(file(BINARY_START, "OcTree", 6, &[2, 0]), "line 5: size is 6; it has to be 2");
    refused(file(BINARY_START, "OcTree", 2, &[2, 0, 9]), "1 bytes follow a tree of 2 nodes");
    refused(file(BINARY_START, "OcTree", 2, &[3, 0, 0, 0]), "a node is 0; it has to be different from 0");
    refused(file(BINARY_START, "OcTree", 2, &[3, 0].repeat(17)), "the depth of the tree is more than 16");
    refused(file(FULL_START, "OcTree", 2, &[0, 0, 0, 0, 1].repeat(17)), "the depth of the tree is more than 16");
    let mut odd = full("OcTree", &Node::Leaf(f32::NAN));
    refused(&odd, "the log-odds of a node is NaN");
    odd.truncate(odd.len() - 1);
    refused(full("OcTree", &small()).split_last().map(|(_, rest)| rest).unwrap_or_default(), "the file ends early");
}

#[test]
fn a_cut_file_is_refused_wherever_it_is_cut() {
    for file in [full("OcTree", &small()), full("ColorOcTree", &small()), binary(&small())] {
        every_cut_is_refused(&file, read);
        no_change_panics(&file, read);
    }
}

fn tree() -> impl Strategy<Value = Node> {
    let leaf = any::<i16>().prop_map(|odds| Node::Leaf(f32::from(odds) / 1000.0));
    let grown = leaf.prop_recursive(10, 200, 8, |child| {
        proptest::collection::btree_map(0_u8..8, child, 1..8)
            .prop_map(|children| Node::Inner(children.into_iter().collect()))
    });
    proptest::collection::btree_map(0_u8..8, grown, 1..8)
        .prop_map(|children| Node::Inner(children.into_iter().collect()))
}

proptest! {
    #[test]
    fn any_tree_is_read_from_either_form(tree in tree()) {
        let mut expected = Vec::new();
        leaves(&tree, [-32768; 3], 65536, &mut expected);
        expected.sort_by_key(|leaf| leaf.0);
        prop_assert_eq!(&sorted(&read(&full("OcTree", &tree)).expect("full")), &expected);
        prop_assert_eq!(&sorted(&read(&full("ColorOcTree", &tree)).expect("coloured")), &expected);
        let sharp = |leaf: &([i32; 3], i32, f32)| {
            (leaf.0, leaf.1, if leaf.2 < 0.0 { FREE_LOG_ODDS } else { OCCUPIED_LOG_ODDS })
        };
        let expected: Vec<_> = expected.iter().map(sharp).collect();
        prop_assert_eq!(sorted(&read(&binary(&tree)).expect("binary")), expected);
    }

    #[test]
    fn random_data_never_panics(nodes in 0_u64..40, data in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = read(&file(BINARY_START, "OcTree", nodes, &data));
        let _ = read(&file(FULL_START, "OcTree", nodes, &data));
        let _ = read(&file(FULL_START, "ColorOcTree", nodes, &data));
        // Random floats are seldom finite and small; zeros between them let the reader proceed further.
        let sparse: Vec<u8> = data.iter().flat_map(|&byte| [0, 0, 0, 0, byte]).collect();
        let _ = read(&file(FULL_START, "OcTree", nodes, &sparse));
    }
}
