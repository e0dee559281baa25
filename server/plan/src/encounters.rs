//! Expected encounters with people along straight ways, from their flows.
//!
//! Encounters are the detections of people near the robot that are expected while it passes: their density around each
//! point of the way, times the area that counts as near, times the time that the robot spends there. Where people are
//! detected once a second, an encounter is one second of one person nearby.
//!
//! Invariant: encounters are finite and at least 0; a way outside of the raster has none.

use std::{collections::HashMap, f64::consts::PI};

use tidemap_model::models::{FlowModel, Moment};

/// People within this distance of the robot are near, by default, metres.
pub const NEAR_M: f64 = 1.0;
/// The greatest distance that counts as near, in cells: the work of a slot grows with its square.
pub const NEAR_MAX_CELLS: f64 = 20.0;
/// The flow is taken to be constant for this time: five minutes.
const SLOT_NANOS: i64 = 300 * 1_000_000_000;
/// Number of slots whose densities are kept.
const SLOTS_MAX: usize = 64;

/// Encounters by place and time.
#[derive(Debug)]
pub struct Encounters<'a> {
    model: &'a FlowModel,
    near_m: f64,
    /// By slot: expected detections per second near the middle of each cell.
    near: HashMap<i64, Vec<f64>>,
}

impl<'a> Encounters<'a> {
    /// Encounters within `near_m` metres, above 0, at most [`NEAR_MAX_CELLS`] cells of the model; a greater distance
    /// counts as that.
    pub fn new(model: &'a FlowModel, near_m: f64) -> Encounters<'a> {
        let near_m = if near_m > 0.0 { near_m } else { NEAR_M };
        let near_m = near_m.min(NEAR_MAX_CELLS * model.options().raster.edge_m);
        Encounters { model, near_m, near: HashMap::new() }
    }

    /// Expected encounters on the straight way between two places, x and y in metres, that the robot enters at a moment
    /// and passes in `duration_secs`.
    pub fn along(&mut self, from_m: [f64; 2], to_m: [f64; 2], enter: Moment, duration_secs: f64) -> f64 {
        let raster = self.model.options().raster;
        let length_m = (to_m[0] - from_m[0]).hypot(to_m[1] - from_m[1]);
        let points = (2.0 * length_m / raster.edge_m).ceil().clamp(1.0, 10_000.0);
        let near = self.near_at(enter);
        let at = |point: f64| {
            let share = (point + 0.5) / points;
            let place = [0, 1].map(|axis| from_m[axis] + share * (to_m[axis] - from_m[axis]));
            raster.cell(place).and_then(|cell| near.get(cell)).copied().unwrap_or(0.0)
        };
        let per_sec = (0..points as u32).map(|point| at(f64::from(point))).sum::<f64>() / points;
        let found = per_sec * duration_secs;
        if found.is_finite() { found.max(0.0) } else { 0.0 }
    }

    /// Expected detections per second near the middle of each cell of the raster.
    fn near_at(&mut self, at: Moment) -> &[f64] {
        let slot = at.civil_nanos().div_euclid(SLOT_NANOS);
        if self.near.len() >= SLOTS_MAX && !self.near.contains_key(&slot) {
            self.near.clear();
        }
        let (model, near_m) = (self.model, self.near_m);
        // The flow is taken at the middle of the slot, so that the result does not depend on the time of the first
        // request.
        let to_middle = slot.saturating_mul(SLOT_NANOS).saturating_add(SLOT_NANOS / 2) - at.civil_nanos();
        let at = Moment { utc_nanos: at.utc_nanos.saturating_add(to_middle), ..at };
        self.near.entry(slot).or_insert_with(|| near_cells(model, at, near_m))
    }
}

/// The mean density of the cells near each cell, times the near area. Outside of the raster there are no people.
fn near_cells(model: &FlowModel, at: Moment, near_m: f64) -> Vec<f64> {
    let options = model.options();
    let (raster, nobody) = (options.raster, model.unseen_per_sec() * options.directions as f64);
    let mut rates = vec![nobody; raster.cells()];
    for flow in model.at(at) {
        rates[flow.cell] = flow.total_per_sec();
    }
    let [width, height] = raster.counts.map(|count| count as i64);
    let reach = (near_m / raster.edge_m).floor() as i64;
    let is_near = |(x, y): &(i64, i64)| ((x * x + y * y) as f64).sqrt() * raster.edge_m <= near_m;
    let around: Vec<(i64, i64)> =
        (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y))).filter(is_near).collect();
    let scale = PI * near_m * near_m / (raster.edge_m * raster.edge_m);
    let near = |cell: usize| {
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        let inside = around.iter().map(|(dx, dy)| (x + dx, y + dy));
        let inside = inside.filter(|(x, y)| (0..width).contains(x) && (0..height).contains(y));
        inside.map(|(x, y)| rates[(x + y * width) as usize]).sum::<f64>() / around.len() as f64 * scale
    };
    (0..rates.len()).map(near).collect()
}

#[cfg(test)]
mod tests {
    use tidemap_model::{
        Periodicities, StopSignal,
        models::{FlowDetection, FlowOptions, FlowRaster},
    };

    use super::*;

    const HOUR_NANOS: i64 = 3_600_000_000_000;

    fn at(hour: i64) -> Moment {
        Moment { utc_nanos: hour * HOUR_NANOS, offset_secs: 0 }
    }

    /// People pass through the middle of the third cell of a row from 8 to 12 o'clock, one each ten minutes.
    fn crowd() -> FlowModel {
        let raster = FlowRaster { low_m: [0.0, 0.0], edge_m: 2.0, counts: [6, 3] };
        let times = (0..21 * 144_i64).filter(|step| (8..12).contains(&(step % 144 / 6)));
        let walk = |step: i64| {
            let moment = Moment { utc_nanos: step * HOUR_NANOS / 6, offset_secs: 0 };
            FlowDetection { moment, place_m: [5.0, 3.0], direction_rad: 1.6 }
        };
        let detections: Vec<FlowDetection> = times.map(walk).collect();
        FlowModel::train(&detections, &Periodicities::default(), &FlowOptions::new(raster), StopSignal::NEVER).unwrap()
    }

    #[test]
    fn encounters_are_where_and_when_people_walk() {
        let model = crowd();
        let mut encounters = Encounters::new(&model, 1.0);
        let mut along = |y: f64, hour: i64| encounters.along([4.0, y], [6.0, y], at(24 * 23 + hour), 600.0);
        // A person every ten minutes in 4 m², of which π m² are near.
        let through = along(3.0, 10);
        assert!((through / (PI / 4.0) - 1.0).abs() < 0.25, "{through}");
        assert!(along(3.0, 20) < 0.1 * through && along(5.0, 10) < 0.05 * through);
        let outside = encounters.along([20.0, 3.0], [30.0, 3.0], at(10), 600.0);
        assert_eq!(outside, 0.0);
    }

    #[test]
    fn encounters_grow_with_the_time_and_the_reach() {
        let model = crowd();
        let along = |near_m: f64, secs: f64| {
            Encounters::new(&model, near_m).along([4.0, 3.0], [6.0, 3.0], at(24 * 23 + 10), secs)
        };
        assert!((along(1.0, 1_200.0) - 2.0 * along(1.0, 600.0)).abs() < 1e-12);
        assert!(along(1.9, 600.0) > 3.0 * along(1.0, 600.0));
        // A distance of two metres reaches the four neighbours, where nobody is: five times fewer people on four times
        // the area.
        assert!(along(2.0, 600.0) < along(1.9, 600.0));
    }

    #[test]
    fn the_order_of_questions_does_not_matter() {
        let model = crowd();
        let ask = |minutes: [i64; 2]| {
            let mut encounters = Encounters::new(&model, 1.0);
            minutes.map(|minute| {
                let enter = Moment { utc_nanos: at(24 * 23 + 7).utc_nanos + minute * HOUR_NANOS / 60, offset_secs: 0 };
                encounters.along([4.0, 3.0], [6.0, 3.0], enter, 60.0)
            })
        };
        let [one, other] = ask([56, 59]);
        assert_eq!(ask([59, 56]), [other, one]);
    }

    #[test]
    fn a_far_reach_is_bounded_by_the_cells() {
        let model = crowd();
        let along = |near_m: f64| Encounters::new(&model, near_m).along([4.0, 3.0], [6.0, 3.0], at(10), 60.0);
        assert_eq!(along(1e9), along(NEAR_MAX_CELLS * 2.0));
    }

    #[test]
    fn many_times_do_not_pile_up() {
        let model = crowd();
        let mut encounters = Encounters::new(&model, 1.0);
        for hour in 0..200 {
            encounters.along([4.0, 3.0], [6.0, 3.0], at(hour), 1.0);
        }
        assert!(encounters.near.len() <= SLOTS_MAX);
    }
}
