//! Imported maps (OctoMap, Nav2) as masks of a grid's cells.
//!
//! A reading of a cell is free or occupied, nothing between: a probability of a map is rounded, or left out.
//!
//! Invariant: unknown space counts as not observed; if two parts of a map share a cell, occupied wins. Rounded and
//! omitted cells are counted. The number of tiles is checked before they are allocated.

mod counts;

use std::{collections::HashMap, str::FromStr};

use tidemap_client::{
    maps::{CellBox, CellIndex, GridSpec},
    observe::tiles::{Mask, TileIndex, TileMasks},
};

pub(crate) use counts::CellCounts;
use tidemap_formats::{
    nav2::{self, GridMode},
    octomap::{Leaf, OctoMap},
};

/// Maximum number of tiles of one map: 33 million cells.
const TILES_MAX: u64 = 1 << 16;
const EDGE: i32 = 8;
/// Cells of a grid lie within this many cells of its origin, along each axis.
const REACH_CELLS: f64 = (1_u32 << 23) as f64;
/// Origins that are proposed are whole multiples of this, metres.
const ORIGIN_STEP_M: f64 = 100.0;
/// Maximum misalignment without a notice, in cells.
const OFF_MAX: f64 = 0.01;

/// The masks of a map's cells.
#[derive(Debug)]
pub(crate) struct GridMasks {
    pub(crate) tiles: Vec<(TileIndex, TileMasks)>,
    /// A notice about the alignment, if there is one.
    pub(crate) notice: Option<String>,
    pub(crate) counts: CellCounts,
    /// The cells that the map is a picture of, where it has a size.
    pub(crate) shown: Option<CellBox>,
}

/// The treatment of a cell that a map gives a probability between free and occupied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Between {
    /// The cell is occupied from this probability on, and free below it.
    OccupiedFrom(f64),
    /// The cell is not used.
    Leave,
}

impl Default for Between {
    fn default() -> Self {
        Self::OccupiedFrom(0.5)
    }
}

impl FromStr for Between {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            _ if text == "leave" => Ok(Self::Leave),
            Ok(from) if from > 0.0 && from <= 1.0 => Ok(Self::OccupiedFrom(from)),
            _ => {
                Err(format!("{text:?}: use a probability above 0, at most 1, from which a cell is occupied; or leave"))
            }
        }
    }
}

/// Checks that the corners of something are cells that a grid can have.
///
/// # Errors
/// The cells are too far from the origin of the grid; the message proposes another origin.
pub(crate) fn check_reach(grid: &GridSpec, low_m: [f64; 3], high_m: [f64; 3]) -> anyhow::Result<()> {
    let cells = |at_m: f64, axis: usize| ((at_m - grid.origin_m[axis]) / grid.resolution_m).abs();
    if (0..3).all(|axis| cells(low_m[axis], axis).max(cells(high_m[axis], axis)) < REACH_CELLS) {
        return Ok(());
    }
    let origin =
        low_m.map(|low| if low.abs() < ORIGIN_STEP_M { 0.0 } else { (low / ORIGIN_STEP_M).floor() * ORIGIN_STEP_M });
    let [x, y, z] = origin;
    let [low_x, low_y, _] = low_m;
    anyhow::bail!(
        "it lies at {low_x}, {low_y} m, and the cells of a grid of {} m lie within {:.0} m of its origin: create the map \
         with an origin near the data, such as --grid resolution={},origin={x}:{y}:{z}",
        grid.resolution_m,
        REACH_CELLS * grid.resolution_m,
        grid.resolution_m,
    )
}

/// The alignment of a map's cells with the cells of the grid.
#[derive(Clone, Copy, Debug)]
struct CellAlignment {
    /// Grid cells per map cell along an axis.
    times: i64,
    /// Grid cell where the map's cell (0, 0, 0) begins.
    offset: [i64; 3],
    off_cells: f64,
    /// The origin with which a grid's cells would line up.
    origin_m: [f64; 3],
}

impl CellAlignment {
    fn new(resolution_m: f64, origin_m: [f64; 3], grid: &GridSpec) -> anyhow::Result<Self> {
        let ratio = resolution_m / grid.resolution_m;
        let times = ratio.round();
        anyhow::ensure!(
            times >= 1.0 && (ratio - times).abs() < 1e-6 * times,
            "its cells are {resolution_m} m wide and those of the grid {} m: they have to be equal, or a whole multiple",
            grid.resolution_m
        );
        let exact: [f64; 3] = std::array::from_fn(|axis| (origin_m[axis] - grid.origin_m[axis]) / grid.resolution_m);
        let off = exact.iter().map(|exact| (exact - exact.round()).abs()).fold(0.0, f64::max);
        Ok(Self { times: times as i64, offset: exact.map(|exact| exact.round() as i64), off_cells: off, origin_m })
    }

    /// The grid cells that a box of map cells covers.
    fn cells(&self, min: [i64; 3], size: [i64; 3]) -> ([i64; 3], [i64; 3]) {
        let from: [i64; 3] = std::array::from_fn(|axis| self.offset[axis] + min[axis] * self.times);
        (from, std::array::from_fn(|axis| from[axis] + size[axis] * self.times))
    }

    fn notice(&self, also: Option<&str>) -> Option<String> {
        let off = (self.off_cells > OFF_MAX)
            .then(|| {
                let ([x, y, z], off) = (self.origin_m, self.off_cells);
                format!(
                    "its cells do not line up with the grid's: moved by {off:.2} of a cell. A grid with --grid …,origin={x}:{y}:{z} \
                     has the same cells"
                )
            });
        let all: Vec<String> = off.into_iter().chain(also.map(str::to_owned)).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }
}

/// The tiles that are filled from a map.
#[derive(Debug)]
struct TileFill {
    /// Observed and occupied cells.
    tiles: HashMap<TileIndex, [Mask; 2]>,
    /// The box of the allowed cells.
    allowed: ([i64; 3], [i64; 3]),
    counts: CellCounts,
}

impl TileFill {
    fn new(grid: &GridSpec) -> Self {
        let far = i64::from(i32::MAX / 4);
        let (mut min, mut max) = ([-far; 3], [far; 3]);
        if let Some(CellBox { min: lowest, max: beyond }) = grid.extent {
            (min, max) = (<[i32; 3]>::from(lowest).map(i64::from), <[i32; 3]>::from(beyond).map(i64::from));
        }
        if grid.is_flat {
            (min[2], max[2]) = (0, 1);
        }
        Self { tiles: HashMap::new(), allowed: (min, max), counts: CellCounts::default() }
    }

    fn fill(&mut self, (from, to): ([i64; 3], [i64; 3]), occupied: bool) -> anyhow::Result<()> {
        let min: [i64; 3] = std::array::from_fn(|axis| from[axis].max(self.allowed.0[axis]));
        let max: [i64; 3] = std::array::from_fn(|axis| to[axis].min(self.allowed.1[axis]));
        let whole: i64 = (0..3).map(|axis| to[axis] - from[axis]).product();
        let within: i64 = (0..3).map(|axis| (max[axis] - min[axis]).max(0)).product();
        self.counts.outside += (whole - within).unsigned_abs();
        if within == 0 {
            return Ok(());
        }
        let edge = i64::from(EDGE);
        let first = min.map(|cell| cell.div_euclid(edge));
        let last = max.map(|cell| (cell - 1).div_euclid(edge));
        let count: i128 = (0..3).map(|axis| i128::from(last[axis] - first[axis] + 1)).product();
        anyhow::ensure!(
            count <= i128::from(TILES_MAX) && self.tiles.len() as u64 <= TILES_MAX,
            "it fills more than {TILES_MAX} tiles of 8x8x8 cells: cut the map to the relevant part, or give the grid a size"
        );
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    self.fill_tile([x, y, z], min, max, occupied);
                }
            }
        }
        Ok(())
    }

    fn fill_tile(&mut self, tile: [i64; 3], min: [i64; 3], max: [i64; 3], occupied: bool) {
        let edge = i64::from(EDGE);
        let from: [u32; 3] = std::array::from_fn(|axis| (min[axis] - tile[axis] * edge).clamp(0, edge) as u32);
        let to: [u32; 3] = std::array::from_fn(|axis| (max[axis] - tile[axis] * edge).clamp(0, edge) as u32);
        // Within `allowed`, tile indices fit in i32.
        let [x, y, z] = tile.map(|index| index as i32);
        let [observed, taken] = self.tiles.entry(TileIndex { x, y, z }).or_default();
        let row = row_bits(from[0], to[0]);
        let layer = (from[1]..to[1]).fold(0_u64, |layer, y| layer | row << (8 * y));
        for z in from[2]..to[2] {
            observed.0[z as usize] |= layer;
            if occupied {
                taken.0[z as usize] |= layer;
            }
        }
    }

    fn into_seen(self) -> Vec<(TileIndex, TileMasks)> {
        let seen = |(tile, [observed, occupied]): (_, [Mask; 2])| (tile, TileMasks::clipped(observed, occupied));
        let mut tiles: Vec<_> = self.tiles.into_iter().map(seen).collect();
        // A fixed order, so that the same map always makes the same scan.
        tiles.sort_unstable_by_key(|(tile, _)| (tile.z, tile.y, tile.x));
        tiles
    }
}

/// Bits `from..to` of a row of 8.
fn row_bits(from: u32, to: u32) -> u64 {
    ((1_u64 << to) - 1) & !((1_u64 << from) - 1)
}

/// The known cells of an OctoMap.
pub(crate) fn of_octomap(map: &OctoMap, grid: &GridSpec) -> anyhow::Result<GridMasks> {
    let alignment = CellAlignment::new(map.resolution_m, [0.0; 3], grid)?;
    let mut tiles = TileFill::new(grid);
    let corner = |leaf: &Leaf, beyond: i32| leaf.min_cell.map(|cell| f64::from(cell + beyond) * map.resolution_m);
    for leaf in &map.leaves {
        check_reach(grid, corner(leaf, 0), corner(leaf, leaf.size_cells.try_into().unwrap_or(i32::MAX / 2)))?;
        let cells = alignment.cells(leaf.min_cell.map(i64::from), [i64::from(leaf.size_cells); 3]);
        tiles.fill(cells, leaf.occupied)?;
    }
    let also = grid.is_flat.then_some("the grid is flat: only the layer z = 0 is used");
    let counts = tiles.counts;
    Ok(GridMasks { tiles: tiles.into_seen(), notice: alignment.notice(also), counts, shown: None })
}

/// The known cells of a 2D grid of a mode. In mode trinary, map servers show cells between the thresholds as unknown.
pub(crate) fn of_plane(
    map: &nav2::Grid,
    mode: GridMode,
    between: Option<Between>,
    grid: &GridSpec,
) -> anyhow::Result<GridMasks> {
    let [x_m, y_m] = map.origin_m;
    let length = |cells: u32| f64::from(cells) * map.resolution_m;
    let [width_m, height_m] = map.size_cells.map(length);
    check_reach(grid, [x_m, y_m, grid.origin_m[2]], [x_m + width_m, y_m + height_m, grid.origin_m[2]])?;
    let alignment = CellAlignment::new(map.resolution_m, [x_m, y_m, grid.origin_m[2]], grid)?;
    let mut tiles = TileFill::new(grid);
    // A 2D map is one layer of the grid, whatever the size of its cells.
    tiles.allowed.0[2] = tiles.allowed.0[2].max(0);
    tiles.allowed.1[2] = tiles.allowed.1[2].min(1);
    let width = i64::from(map.size_cells[0]).max(1);
    for (index, cell) in (0_i64..).zip(&map.cells) {
        if let Some(occupied) = tiles.counts.reading(*cell, mode, between.unwrap_or_default()) {
            // The layers that a wider cell of a flat map would also fill are none of its own.
            let (from, to) = alignment.cells([index % width, index / width, 0], [1; 3]);
            tiles.fill((from, [to[0], to[1], from[2] + 1]), occupied)?;
        }
    }
    let also = (!grid.is_flat).then_some("the map is flat: its cells become the layer z = 0");
    let counts = tiles.counts;
    let (from, to) = alignment.cells([0; 3], [i64::from(map.size_cells[0]), i64::from(map.size_cells[1]), 0]);
    // Within the reach of the grid, as checked above.
    let corner = |cell: [i64; 3], z: i32| CellIndex { x: cell[0] as i32, y: cell[1] as i32, z };
    let shown = Some(CellBox { min: corner(from, 0), max: corner(to, 1) });
    Ok(GridMasks { tiles: tiles.into_seen(), notice: alignment.notice(also), counts, shown })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tidemap_formats::nav2::GridCell;

    fn grid() -> GridSpec {
        GridSpec { origin_m: [-0.8, 0.0, 0.0], ..GridSpec::new(0.1) }
    }

    fn count(tiles: &[(TileIndex, TileMasks)]) -> (u32, u32) {
        tiles.iter().fold((0, 0), |(observed, occupied), (_, masks)| {
            (observed + masks.observed().count(), occupied + masks.occupied().count())
        })
    }

    #[test]
    fn leaves_fill_the_cells_that_they_cover() -> anyhow::Result<()> {
        let leaf = |min_cell, size_cells, occupied| Leaf { min_cell, size_cells, occupied, log_odds: 1.0 };
        let leaves = vec![leaf([-2, 0, 0], 2, true), leaf([0, 4, 0], 4, false), leaf([3, 0, -1], 1, true)];
        let on = of_octomap(&OctoMap { resolution_m: 0.2, leaves }, &grid())?;
        // Twice as wide: 8, 64 and 1 leaf cells are 8 cells each.
        assert_eq!(count(&on.tiles), ((8 + 64 + 1) * 8, (8 + 1) * 8));
        assert!(on.notice.is_none(), "{:?}", on.notice);
        let first = on
            .tiles
            .iter()
            .find(|(tile, _)| *tile == TileIndex { x: 0, y: 0, z: 0 })
            .map(|(_, masks)| masks.occupied());
        // The leaf begins 4 cells left of the map's origin, which is cell 8 of the grid.
        assert_eq!(first.map(|occupied| occupied.0[0]), Some(0xF0F0_F0F0));
        let flat = of_octomap(
            &OctoMap { resolution_m: 0.1, leaves: vec![leaf([0, 0, -4], 8, true)] },
            &GridSpec { is_flat: true, ..grid() },
        )?;
        assert_eq!(count(&flat.tiles), (64, 64));
        Ok(())
    }

    #[test]
    fn a_plane_is_one_layer_and_leaves_out_what_it_does_not_know() -> anyhow::Result<()> {
        let cells = vec![GridCell::Free, GridCell::Occupied, GridCell::Unknown, GridCell::Between { percent: 40 }];
        let map = nav2::Grid { resolution_m: 0.2, origin_m: [-0.83, 0.0], size_cells: [2, 2], cells, free_205: 0 };
        let on = of_plane(&map, GridMode::Raw, Some(Between::Leave), &grid())?;
        assert_eq!(count(&on.tiles), (8, 4));
        assert_eq!(on.counts, CellCounts { all: 4, unknown: 1, left: 1, ..CellCounts::default() });
        assert_eq!(on.shown, Some(CellBox { min: [0, 0, 0].into(), max: [4, 4, 1].into() }));
        assert!(
            on.notice.is_some_and(|notice| notice.contains("moved by 0.30") && notice.contains("origin=-0.83:0:0"))
        );
        assert_eq!(on.tiles.iter().map(|(tile, _)| *tile).collect::<Vec<_>>(), [TileIndex { x: 0, y: 0, z: 0 }]);
        Ok(())
    }

    #[test]
    fn cells_between_free_and_occupied_are_rounded_and_counted() -> anyhow::Result<()> {
        let percents = [20, 49, 50, 80].map(|percent| GridCell::Between { percent });
        let map = nav2::Grid {
            resolution_m: 0.1,
            origin_m: [0.0; 2],
            size_cells: [4, 1],
            cells: percents.to_vec(),
            free_205: 0,
        };
        let on = of_plane(&map, GridMode::Scale, None, &grid())?;
        assert_eq!(count(&on.tiles), (4, 2));
        assert_eq!(
            on.counts,
            CellCounts { all: 4, as_free: 2, as_occupied: 2, from: Some(0.5), ..CellCounts::default() }
        );
        let on = of_plane(&map, GridMode::Scale, Some(Between::OccupiedFrom(0.8)), &grid())?;
        assert_eq!((count(&on.tiles), on.counts.as_free), ((4, 1), 3));
        for (text, between) in [("leave", Ok(Between::Leave)), ("0.65", Ok(Between::OccupiedFrom(0.65)))] {
            assert_eq!(text.parse::<Between>(), between);
        }
        assert!(["0", "1.1", "all", "NaN"].iter().all(|text| text.parse::<Between>().is_err()));
        Ok(())
    }

    #[test]
    fn cells_outside_of_the_grid_are_counted() -> anyhow::Result<()> {
        let cells = vec![GridCell::Free; 6];
        let map = nav2::Grid { resolution_m: 0.1, origin_m: [0.0; 2], size_cells: [3, 2], cells, free_205: 0 };
        let extent = Some(CellBox { min: [8, 0, 0].into(), max: [10, 2, 4].into() });
        let on = of_plane(&map, GridMode::Trinary, None, &GridSpec { extent, ..grid() })?;
        assert_eq!((count(&on.tiles), on.counts.outside), ((4, 0), 2));
        Ok(())
    }

    #[test]
    fn the_error_of_a_map_far_from_the_origin_names_a_fitting_origin() {
        let cells = vec![GridCell::Free];
        let map = nav2::Grid {
            resolution_m: 0.1,
            origin_m: [458_123.4, 5_548_061.0],
            size_cells: [1, 1],
            cells,
            free_205: 0,
        };
        let error =
            |grid: &GridSpec| of_plane(&map, GridMode::Trinary, None, grid).err().map(|error| error.to_string());
        let far = error(&grid()).unwrap_or_default();
        assert!(far.contains("458123.4, 5548061 m") && far.contains("within 838861 m"), "{far}");
        assert!(far.contains("--grid resolution=0.1,origin=458100:5548000:0"), "{far}");
        assert_eq!(error(&GridSpec { origin_m: [458_100.0, 5_548_000.0, 0.0], ..grid() }), None);
        let leaves = vec![Leaf { min_cell: [4_581_000, 55_480_000, 2], size_cells: 1, occupied: true, log_odds: 1.0 }];
        let octomap = of_octomap(&OctoMap { resolution_m: 0.1, leaves }, &grid()).err().map(|error| error.to_string());
        assert!(octomap.is_some_and(|error| error.contains("origin=458100:5548000:0")));
    }

    #[test]
    fn what_does_not_fit_is_refused_with_the_reason() {
        let leaf = Leaf { min_cell: [-16384; 3], size_cells: 16384, occupied: false, log_odds: -1.0 };
        let map = |resolution_m| OctoMap { resolution_m, leaves: vec![leaf] };
        let error = |map: &OctoMap, grid: &GridSpec| of_octomap(map, grid).err().map(|error| error.to_string());
        assert!(error(&map(0.15), &grid()).is_some_and(|error| error.contains("0.15 m wide")));
        assert!(error(&map(0.05), &grid()).is_some_and(|error| error.contains("0.05 m wide")));
        assert!(error(&map(0.1), &grid()).is_some_and(|error| error.contains("more than 65536 tiles")));
        let extent = Some(CellBox { min: [-20; 3].into(), max: [0; 3].into() });
        let cut = of_octomap(&map(0.1), &GridSpec { extent, ..grid() });
        assert_eq!(cut.map(|on| count(&on.tiles)).ok(), Some((20 * 20 * 20, 0)), "the rest lies outside of the grid");
    }
}
