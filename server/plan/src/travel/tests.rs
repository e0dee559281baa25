//! Checks paths around obstacles against relaxation of all steps until convergence.

use proptest::prelude::*;
use tidemap_grid::index::CellBox;

use super::*;
use crate::predicted::tests::spec;

/// A flat grid drawn as text, the first line at the highest y: `#` occupied, `?` unknown, else free.
pub(crate) fn drawn(lines: &[&str]) -> PredictedGrid {
    let max = CellIndex { x: lines[0].len() as i32, y: lines.len() as i32, z: 1 };
    let lattice = Lattice::new(&spec(true), CellBox { min: CellIndex::default(), max }, 1 << 20).unwrap();
    PredictedGrid::from_fn(Arc::new(lattice), |cell| {
        match lines[lines.len() - 1 - cell.y as usize].as_bytes()[cell.x as usize] {
            b'#' => Some(1.0),
            b'?' => None,
            _ => Some(0.0),
        }
    })
}

fn thin() -> TravelOptions {
    TravelOptions { radius_m: 0.0, ..TravelOptions::default() }
}

fn travel(lines: &[&str], options: &TravelOptions) -> TravelGrid {
    TravelGrid::new(&drawn(lines), options).unwrap()
}

fn to(grid: &TravelGrid, from: (usize, usize), to: (usize, usize)) -> Option<f64> {
    let column = |(x, y)| Column { x, y };
    grid.distances(column(from)).to(column(to)).map(|metres| metres / 0.1)
}

#[test]
fn ways_lead_around_walls_and_not_across_corners() {
    let grid = travel(&["....", ".##.", ".#..", "...."], &thin());
    let root = std::f64::consts::SQRT_2;
    assert!((to(&grid, (0, 0), (3, 3)).unwrap() - (4.0 + root)).abs() < 1e-9);
    assert_eq!(to(&grid, (0, 0), (1, 1)), None);
    let gap = travel(&[".#", "#."], &thin());
    assert_eq!(to(&gap, (0, 1), (1, 0)), None);
    let open = travel(&["...", "...", "..."], &thin());
    assert!((to(&open, (0, 0), (2, 2)).unwrap() - 2.0 * root).abs() < 1e-9);
}

#[test]
fn a_wide_robot_does_not_fit_through_a_narrow_door() {
    let lines =
        ["...........", ".....#.....", ".....#.....", "...........", ".....#.....", ".....#.....", "..........."];
    let lines: Vec<String> = lines.iter().map(|line| line.replace(' ', ".")).collect();
    let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
    let wide = |radius_m: f64| travel(&lines, &TravelOptions { radius_m, ..TravelOptions::default() });
    assert!((to(&wide(0.0), (1, 3), (9, 3)).unwrap() - 8.0).abs() < 1e-9);
    // A door of one cell: its middle is 5 cm from the jambs.
    assert!((to(&wide(0.05), (1, 3), (9, 3)).unwrap() - 8.0).abs() < 1e-9);
    assert!(to(&wide(0.06), (1, 3), (9, 3)).is_none_or(|cells| cells > 8.0));
    // Closed columns are those whose centre is nearer to the obstacle's cell than the radius.
    let post = travel(
        &[".......", ".......", ".......", "...#...", ".......", ".......", "......."],
        &TravelOptions { radius_m: 0.2, ..TravelOptions::default() },
    );
    let closed = (0..49).filter(|at| !post.is_passable(Column { x: at % 7, y: at / 7 })).count();
    assert_eq!(closed, 21);
}

#[test]
fn unknown_columns_are_entered_only_on_request() {
    let lines = ["..?..", "..?..", "..?.."];
    assert_eq!(to(&travel(&lines, &thin()), (0, 1), (4, 1)), None);
    let bold = TravelOptions { unknown_is_passable: true, ..thin() };
    assert!((to(&travel(&lines, &bold), (0, 1), (4, 1)).unwrap() - 4.0).abs() < 1e-9);
}

#[test]
fn only_what_is_at_the_robots_height_is_in_its_way() {
    let region = CellBox { min: CellIndex::default(), max: CellIndex { x: 3, y: 1, z: 10 } };
    let lattice = Arc::new(Lattice::new(&spec(false), region, 1000).unwrap());
    // A table top at 0.7 to 0.8 m, the floor at 0.2 m.
    let grid = PredictedGrid::from_fn(lattice, |cell| {
        Some(if cell.z == 0 || (cell.z == 5 && cell.x == 1) { 1.0 } else { 0.0 })
    });
    let is_passable = |z_min_m, z_max_m| {
        let options = TravelOptions { z_min_m, z_max_m, ..thin() };
        TravelGrid::new(&grid, &options).unwrap().is_passable(Column { x: 1, y: 0 })
    };
    assert!(is_passable(0.3, 0.7));
    assert!(!is_passable(0.3, 0.71));
    assert!(!is_passable(0.29, 0.7));
    let options = TravelOptions { z_min_m: 5.0, z_max_m: 6.0, ..thin() };
    assert_eq!(TravelGrid::new(&grid, &options).unwrap_err(), InvalidTravel::NoCell { min_m: 5.0, max_m: 6.0 });
}

#[test]
fn mistakes_name_the_value() {
    let good = TravelOptions::default();
    for (wrong, word) in [
        (TravelOptions { z_min_m: f64::NAN, ..good }, "NaN"),
        (TravelOptions { z_min_m: 2.0, ..good }, "heights 2 to 1.8"),
        (TravelOptions { radius_m: -0.1, ..good }, "radius -0.1"),
        (TravelOptions { radius_m: f64::INFINITY, ..good }, "radius inf"),
        (TravelOptions { threshold: 1.1, ..good }, "threshold 1.1"),
    ] {
        let error = TravelGrid::new(&drawn(&["."]), &wrong).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn the_nearest_free_place_is_found() {
    let grid = travel(&["..###", "..###", "..###"], &thin());
    let at = grid.centre_m(Column { x: 4, y: 1 });
    let (column, away) = grid.nearest(at[0], at[1], 0.5).unwrap();
    assert_eq!(column, Column { x: 1, y: 1 });
    assert!((away - 0.3).abs() < 1e-9);
    assert_eq!(grid.nearest(at[0], at[1], 0.25), None);
    assert_eq!(grid.nearest(f64::NAN, 0.0, 1.0), None);
    assert_eq!(grid.nearest(at[0] + 50.0, at[1], 100.0), None);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn distances_are_the_shortest(
        cells in prop::collection::vec(prop::sample::select(vec![b'.', b'.', b'.', b'#', b'?']), 80),
        from in 0_usize..80,
        radius_m in prop_oneof![Just(0.0), 0.0_f64..0.2],
    ) {
        let lines: Vec<&str> = cells.chunks(10).map(|line| std::str::from_utf8(line).unwrap()).collect();
        let grid = travel(&lines, &TravelOptions { radius_m, ..TravelOptions::default() });
        let occupied = |x: usize, y: usize| lines[7 - y].as_bytes()[x] == b'#';
        let column = |at: usize| Column { x: at % 10, y: at / 10 };
        for at in 0..80 {
            let Column { x, y } = column(at);
            let gap = |one: usize, other: usize| (one.abs_diff(other) as f64 - 0.5).max(0.0) * 0.1;
            let is_near = |other: usize| {
                let other = column(other);
                occupied(other.x, other.y)
                    && (other == column(at) || gap(x, other.x).hypot(gap(y, other.y)) < radius_m - 1e-10)
            };
            let free = lines[7 - y].as_bytes()[x] == b'.' && !(0..80).any(is_near);
            prop_assert_eq!(grid.is_passable(column(at)), free);
        }
        let mut lengths = [f64::INFINITY; 80];
        if grid.is_passable(column(from)) {
            lengths[from] = 0.0;
        }
        for _ in 0..80 {
            for at in 0..80 {
                for to in 0..80 {
                    let (one, other) = (column(at), column(to));
                    let (dx, dy) = (one.x.abs_diff(other.x), one.y.abs_diff(other.y));
                    let corners = [Column { x: one.x, y: other.y }, Column { x: other.x, y: one.y }, other];
                    if dx <= 1 && dy <= 1 && corners.iter().all(|corner| grid.is_passable(*corner)) {
                        lengths[to] = lengths[to].min(lengths[at] + ((dx + dy) as f64).sqrt());
                    }
                }
            }
        }
        let distances = grid.distances(column(from));
        for (at, &length) in lengths.iter().enumerate() {
            let steps = distances.to(column(at)).map_or(f64::INFINITY, |metres| metres / 0.1);
            prop_assert!(steps == length || (steps - length).abs() < 1e-9);
        }
    }
}
