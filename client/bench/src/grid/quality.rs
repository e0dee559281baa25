//! The estimation error of the models on their training data (T-RO 2017, section VI.B).
//!
//! Invariant: the simulated office is the ground truth; only cells that change count.

use tidemap_client::{
    Client,
    queries::{GridQuery, ModelKind, ModelSelector, WholeGrid},
};
use tidemap_sim::GridOffice;

use super::{Figures, GridArgs, office};
use tidemap_formats::table::Cell;
use tidemap_terminal::progress::{Bar, status_line};

/// The compared orders: the static model, and the orders of the paper.
const ORDERS: [(u32, &str); 6] = [
    (0, "error_percent_order_0"),
    (1, "error_percent_order_1"),
    (2, "error_percent_order_2"),
    (3, "error_percent_order_3"),
    (4, "error_percent_order_4"),
    (5, "error_percent_order_5"),
];

/// The true states of the changing cells at one scan, in their order.
struct Truth {
    utc_nanos: i64,
    occupied: Vec<bool>,
}

/// The estimation error of each order over the changing cells, at `scans_a_day` scans of each day, in percent.
pub(super) async fn estimation_errors(
    client: &Client,
    map: &str,
    args: &GridArgs,
    scans_a_day: u32,
) -> anyhow::Result<Figures> {
    let office = office::make(args)?;
    status_line("comparing the orders with the office");
    let bar = Bar::count("days compared");
    let mut wrong = [0_u64; ORDERS.len()];
    let mut compared = 0_u64;
    for day in 0..args.days {
        for truth in truths(&office, day, scans_a_day) {
            compared += truth.occupied.len() as u64;
            for ((order, _), wrong) in ORDERS.iter().zip(&mut wrong) {
                let model = ModelSelector {
                    kind: ModelKind::Spectral,
                    order: Some(*order as usize),
                    ..ModelSelector::default()
                };
                let query =
                    GridQuery { map: map.to_owned(), time_nanos: truth.utc_nanos, model, ..GridQuery::default() };
                let predicted = client.predict_grid(&query).await?.whole().await?;
                *wrong += differing(&office, &truth, &predicted);
            }
        }
        bar.set_of(u64::from(day) + 1, u64::from(args.days));
    }
    bar.clear();
    let percent = |wrong: u64| Cell::from(100.0 * wrong as f64 / compared.max(1) as f64);
    Ok(ORDERS.iter().zip(wrong).map(|((_, name), wrong)| (*name, percent(wrong))).collect())
}

/// The changing cells at some scans of a day, spread over it and shifted from day to day.
fn truths(office: &GridOffice, day: u32, scans_a_day: u32) -> Vec<Truth> {
    let cells = office.changing_cells();
    let mut slots: Vec<[u64; 8]> = (0..).zip(office.tiles()).map(|(slot, _)| office.shown_before(day, slot)).collect();
    let scans = office.day(day);
    let step = (scans.len() / scans_a_day.max(1) as usize).max(1);
    let shift = (day as usize * 997) % step;
    let mut truths = Vec::new();
    for (number, scan) in scans.iter().enumerate() {
        for &flip in scan.occupied_flips {
            slots[flip as usize / 512][flip as usize % 512 / 64] ^= 1 << (flip % 64);
        }
        if number % step == shift && truths.len() < scans_a_day as usize {
            let is_occupied =
                |&cell: &u32| slots[cell as usize / 512][cell as usize % 512 / 64] >> (cell % 64) & 1 == 1;
            truths.push(Truth { utc_nanos: scan.utc_nanos, occupied: cells.iter().map(is_occupied).collect() });
        }
    }
    truths
}

/// The number of changing cells on the other side of 0.5 than their prediction.
fn differing(office: &GridOffice, truth: &Truth, predicted: &WholeGrid) -> u64 {
    let by_place: std::collections::HashMap<[i32; 3], usize> =
        predicted.tiles.iter().enumerate().map(|(number, tile)| (tile.place, number)).collect();
    let is_wrong = |(&cell, &occupied): (&u32, &bool)| {
        let place = office.tiles()[cell as usize / 512];
        let value = by_place.get(&place).and_then(|&number| predicted.tiles[number].cells[cell as usize % 512].value());
        (value.unwrap_or(0.5) >= 0.5) != occupied
    };
    office.changing_cells().iter().zip(&truth.occupied).filter(|pair| is_wrong(*pair)).count() as u64
}
