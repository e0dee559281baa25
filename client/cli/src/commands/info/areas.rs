//! `tidemap info` without targets: the areas of the grid where observations give most information.
//!
//! Invariant: an area's information is the sum over its known cells, each as in `info --state cell/X/Y/Z`. Areas are
//! squares of the map's frame, so that the same square has the same name at every time.

use std::collections::HashMap;

use tidemap_client::{
    exploration::Certainty,
    queries::{GridQuery, ModelSelector, WholeGrid},
};
use tidemap_formats::table::Cell;
use tidemap_model::entropy_bits;

use crate::{
    commands::{
        Session, UsageError,
        grid::predict::{heights, known_centres},
        predict::check_for_cells,
        usage,
    },
    progress::status_line,
};

/// Heights that matter to a robot, metres.
const HEIGHTS_M: (f64, f64) = (0.1, 1.8);

/// The side of an area, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Side(f64);

impl std::str::FromStr for Side {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let right = || format!("{text:?}: the side of an area is metres, above 0, such as 2");
        text.parse().ok().filter(|side: &f64| side.is_finite() && *side > 0.0).map(Self).ok_or_else(right)
    }
}

/// Sums over the cells of an area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AreaSums {
    entropy_bits: f64,
    information_bits: f64,
}

/// The areas of a map's grid at times, best first: rows of target, entropy, information and time.
pub(super) async fn rows(
    session: &Session,
    (map, times, model): (&str, &[i64], ModelSelector),
    side: Side,
    count: usize,
) -> anyhow::Result<Vec<Vec<Cell>>> {
    check_for_cells(model)?;
    let known = session.client.map(map).await?;
    if known.grid.is_none() {
        return Err(UsageError("name targets with --state, --location or --view".to_owned()).into());
    }
    // A map of one layer may lie below these heights.
    let layers = known.grid_summary.and_then(|summary| summary.region).unwrap_or_default();
    let region = heights(&known, HEIGHTS_M.0, HEIGHTS_M.1).filter(|region| !region.intersection(&layers).is_empty());
    let mut rows = Vec::new();
    let mut left = 0;
    for &time_nanos in times {
        let query = GridQuery { map: map.to_owned(), time_nanos, model, region, ..GridQuery::default() };
        let predicted = session.client.predict_grid(&query).await?.whole().await?;
        let areas = best_first(&predicted, side);
        if areas.is_empty() {
            return Err(usage(format!("map {map:?} has no observed cells: send scans with tidemap grid observe")));
        }
        left += areas.len().saturating_sub(count);
        rows.extend(areas.into_iter().take(count).map(|(area, sums)| {
            let AreaSums { entropy_bits, information_bits } = sums;
            vec![Cell::Text(name(area, side)), entropy_bits.into(), information_bits.into(), Cell::Time(time_nanos)]
        }));
    }
    if left > 0 {
        status_line(&format!(
            "{left} more areas give less information; --count N shows more of them, and --area M makes them larger"
        ));
    }
    Ok(rows)
}

/// The areas with known cells, by information; of equal ones the first along x, then y.
fn best_first(predicted: &WholeGrid, Side(side): Side) -> Vec<([i64; 2], AreaSums)> {
    let certainty = Certainty::default();
    let mut areas: HashMap<[i64; 2], AreaSums> = HashMap::new();
    for ([x, y, _], probability) in known_centres(predicted) {
        let sums = areas.entry([x, y].map(|metres| (metres / side).floor() as i64)).or_default();
        sums.entropy_bits += entropy_bits(probability);
        sums.information_bits += certainty.bits(probability);
    }
    let mut areas: Vec<_> = areas.into_iter().collect();
    areas.sort_by(|(one, sums), (other, others)| {
        others.information_bits.total_cmp(&sums.information_bits).then(one.cmp(other))
    });
    areas
}

/// An area as `--region` takes it.
fn name([x, y]: [i64; 2], Side(side): Side) -> String {
    // To a micrometre: the last digits of a product are rounding.
    let edge = |index: i64| (index as f64 * side * 1e6).round() / 1e6;
    format!("{}:{},{}:{}", edge(x), edge(x + 1), edge(y), edge(y + 1))
}

#[cfg(test)]
mod tests {
    use tidemap_client::{
        maps::{CellBox, GridSpec},
        queries::{CellPrediction, GridHeader, PredictedTile},
    };

    use super::*;

    #[test]
    fn areas_are_squares_with_the_sums_of_their_cells() -> Result<(), String> {
        let mut cells = Box::new([CellPrediction::Unknown; 512]);
        // Cells of 0.5 m: of the first square of 2 m one is sure and one is not; of the next one two are not.
        cells[0] = CellPrediction::Static(0.0);
        cells[1] = CellPrediction::Changing(0.5);
        cells[4] = CellPrediction::Changing(0.5);
        cells[5 + 64] = CellPrediction::Changing(0.5);
        let grid = GridSpec { origin_m: [-2.0, 0.0, 0.0], ..GridSpec::new(0.5) };
        let region = CellBox { min: [0; 3].into(), max: [8; 3].into() };
        let header = GridHeader { grid, region, tiles: 1, cells: 512, bytes: 0, generation: 1 };
        let predicted = WholeGrid { header, tiles: vec![PredictedTile { place: [0; 3], cells }] };
        let areas = best_first(&predicted, "2".parse()?);
        let most_bits = Certainty::default().most_bits();
        let sums = |count: f64| AreaSums { entropy_bits: count, information_bits: count * most_bits };
        assert_eq!(areas, [([0, 0], sums(2.0)), ([-1, 0], sums(1.0))]);
        assert_eq!(name([-1, 0], "2".parse()?), "-2:0,0:2");
        assert_eq!(name([3, -1], "0.1".parse()?), "0.3:0.4,-0.1:0");
        assert!(["0", "-1", "NaN", "x"].iter().all(|text| text.parse::<Side>().is_err()));
        Ok(())
    }
}
