//! Each cell has one name.

use super::*;

#[test]
fn cells_have_one_name_each() {
    for (x, y, z) in [(0, 0, 0), (-1, 10, 8_388_607), (-8_388_608, -20, 5)] {
        let cell = CellIndex { x, y, z };
        assert_eq!(cell.name(), format!("cell/{x}/{y}/{z}"));
        assert_eq!(CellIndex::from_name(&cell.name()), Some(Ok(cell)));
    }
    for bad in [
        "cell/",
        "cell/1/2",
        "cell/1/2/3/4",
        "cell/1/2/3/",
        "cell/+1/2/3",
        "cell/01/2/3",
        "cell/-0/2/3",
        "cell/1/2/8388608",
        "cell/1/2/x",
        "cell/1//3",
        "cell/99999999999999/0/0",
        "cell/ 1/2/3",
    ] {
        assert!(matches!(CellIndex::from_name(bad), Some(Err(InvalidCellName(_)))), "{bad}");
    }
    for other in ["door", "cell", "cells/1/2/3", "Cell/1/2/3"] {
        assert_eq!(CellIndex::from_name(other), None);
    }
}
