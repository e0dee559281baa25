//! Maps written as trees, and read by the reader, which shares no code that matters with the writer.
//!
//! Invariant: expected values follow from the cells of the picture, not from the tree.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::{PictureValue, octomap};

/// A picture of this size whose first cell has these indices from the centre of the tree.
fn at(min_cell: [i32; 3], size_cells: [u32; 3], cells: Vec<PictureCell>) -> MapPicture {
    let resolution_m = 0.05;
    MapPicture {
        resolution_m,
        origin_m: min_cell.map(|cell| f64::from(cell) * resolution_m),
        min_cell: [0; 3],
        size_cells,
        cells,
        value: PictureValue::Probability,
        levels: (0.0, 1.0),
    }
}

fn known(probability: f32) -> PictureCell {
    PictureCell::Static { probability }
}

/// The cells of a file, one by one: whether each is occupied.
fn cells_of(file: &[u8]) -> BTreeMap<[i32; 3], bool> {
    let map = octomap::read(file).expect("a valid file");
    assert_eq!(map.resolution_m, 0.05);
    let mut cells = BTreeMap::new();
    for leaf in &map.leaves {
        let [x, y, z] = leaf.min_cell;
        let side = leaf.size_cells as i32;
        for cell in 0..side * side * side {
            let at = [x + cell % side, y + cell / side % side, z + cell / side / side];
            assert_eq!(cells.insert(at, leaf.occupied), None, "{at:?} is in two leaves");
        }
    }
    cells
}

/// The known cells of a picture: whether each is occupied.
fn expected(picture: &MapPicture, min_cell: [i32; 3]) -> BTreeMap<[i32; 3], bool> {
    let cells = picture.known_indices().map(|(index, cell)| {
        let at = std::array::from_fn(|axis| min_cell[axis] + index[axis] as i32);
        (at, cell.probability() >= Some(0.5))
    });
    cells.collect()
}

#[test]
fn bytes_are_those_of_the_format() {
    // The cell at the origin is occupied, its neighbour along x is free.
    let file = write(&at([0; 3], [2, 1, 1], vec![known(0.7), known(0.3)])).expect("a file");
    let data = file.split_at(file.len() - 32);
    let header = "# Octomap OcTree binary file\n# written by tidemap\nid OcTree\nsize 18\nres 0.05\ndata\n";
    assert_eq!(String::from_utf8_lossy(data.0), header);
    // Child 7 of the root is beyond the origin along each axis; of the nodes below it, child 0 touches the origin.
    let mut nodes = vec![0, 0b1100_0000];
    nodes.extend([0b0000_0011, 0].repeat(14));
    nodes.extend([0b0000_0110, 0]);
    assert_eq!(data.1, nodes);
}

#[test]
fn equal_cells_become_one_leaf() {
    let file = write(&at([-64, 0, 64], [64; 3], vec![known(0.0); 64 * 64 * 64])).expect("a file");
    let leaves = octomap::read(&file).expect("a valid file").leaves;
    let cubes: Vec<_> = leaves.iter().map(|leaf| (leaf.min_cell, leaf.size_cells, leaf.occupied)).collect();
    assert_eq!(cubes, [([-64, 0, 64], 64, false)]);
}

#[test]
fn a_map_without_known_cells_is_an_empty_tree() {
    let file = write(&at([5; 3], [3, 2, 1], vec![PictureCell::Unknown; 6])).expect("a file");
    assert!(file.ends_with(b"size 0\nres 0.05\ndata\n"));
    assert_eq!(octomap::read(&file).expect("a valid file").leaves, []);
}

#[test]
fn a_map_reaches_to_the_ends_of_the_tree_and_not_beyond() {
    for (min_cell, size) in [([-32768; 3], [2, 1, 1]), ([32766, 32767, 32767], [2, 1, 1])] {
        let picture = at(min_cell, size, vec![known(1.0), known(0.0)]);
        assert_eq!(cells_of(&write(&picture).expect("a file")), expected(&picture, min_cell));
    }
    for (min_cell, size) in [([-32769, 0, 0], [2, 1, 1]), ([32767, 0, 0], [2, 1, 1]), ([0, 0, 32768], [2, 1, 1])] {
        let error = write(&at(min_cell, size, vec![known(1.0), known(0.0)])).expect_err("it is beyond the tree");
        assert!(matches!(error, PictureError::BeyondTree { .. }), "{error}");
        assert!(error.to_string().contains("1638.4 m"), "{error}");
    }
}

#[test]
fn cells_that_a_tree_cannot_have_are_refused() {
    let mut picture = at([0; 3], [2, 1, 1], vec![known(1.0), known(0.0)]);
    picture.resolution_m = 0.0;
    assert_eq!(write(&picture), Err(PictureError::Resolution(0.0)));
    picture = at([0; 3], [2, 1, 1], vec![known(1.0), known(0.0)]);
    picture.origin_m[1] = 0.02;
    let error = write(&picture).expect_err("it is between cells");
    assert!(matches!(error, PictureError::OffTree { .. }) && error.to_string().contains("0.40"), "{error}");
}

fn cell() -> impl Strategy<Value = PictureCell> {
    prop_oneof![
        Just(PictureCell::Unknown),
        (0.0..=1.0_f32).prop_map(known),
        // Many equal cells, for large leaves.
        Just(known(0.0)),
        Just(PictureCell::Changing { probability: 1.0 }),
    ]
}

/// Runs of equal cells: some pictures are mottled, some have large cubes.
fn pictures() -> impl Strategy<Value = ([i32; 3], MapPicture)> {
    let size = (1..=9_u32, 1..=9_u32, prop_oneof![Just(1_u32), 1..=9_u32]);
    let place = [-300..300_i32, -20..20, -32768..32758];
    (place, size, proptest::collection::vec((cell(), 1..300_usize), 1..40)).prop_map(|(min_cell, (x, y, z), runs)| {
        let runs = runs.iter().flat_map(|&(cell, length)| std::iter::repeat_n(cell, length)).cycle();
        let cells = runs.take((x * y * z) as usize).collect();
        (min_cell, at(min_cell, [x, y, z], cells))
    })
}

proptest! {
    #[test]
    fn any_map_is_read_back((min_cell, picture) in pictures()) {
        prop_assert_eq!(cells_of(&write(&picture).expect("a file")), expected(&picture, min_cell));
    }
}
