//! A map with one state: a day is predicted before it is learned.
//!
//! Invariant: predictions use readings of earlier days only, and are made as a daemon makes them: the value by
//! [`MapView::predict_into`], the intervals by [`MapView::intervals`].

use tidemap_map::{
    event::Observations,
    ids::StateId,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
    view::MapView,
};
use tidemap_model::{HeldInterval, Zone, selector::ModelSelector};

use super::{HabitsError, LEVELS, world::Look};
use crate::nightly_map::NightlyMap;

/// The only state of the map.
pub(super) const STATE: StateId = StateId(0);

/// The predictions of the map for a day.
#[derive(Clone, Debug)]
pub(super) struct DayAhead {
    /// The probability of 1 at each requested time.
    pub(super) values: Vec<f64>,
    /// The interval of each hour, for each of [`LEVELS`].
    pub(super) hours: [Vec<HeldInterval>; LEVELS.len()],
}

/// A map that learns night by night.
#[derive(Debug)]
pub(super) struct HabitLearner(NightlyMap);

impl HabitLearner {
    /// An untrained map with default properties and one state.
    pub(super) fn new(zone: Zone, created_nanos: i64) -> Result<Self, HabitsError> {
        let name = MapName::new("habits").map_err(HabitsError::setting)?;
        let producer = ProducerKey::new("robot", "").map_err(HabitsError::setting)?;
        let mut map = NightlyMap::new(MapSpec { zone, created_nanos, ..MapSpec::new(name) }, producer);
        map.add_probability(StateName::new("state").map_err(HabitsError::setting)?)?;
        Ok(Self(map))
    }

    /// The view of readers of the map.
    pub(super) fn view(&mut self) -> MapView {
        self.0.view()
    }

    /// Predictions of a view at times in nanoseconds UTC, and of hours, each by its middle.
    pub(super) fn ask(view: &MapView, times: &[i64], hours: &[i64]) -> DayAhead {
        let auto = ModelSelector::default();
        let predict = |times: &[i64]| {
            let times = view.prepare(times);
            let mut values = vec![0.0; times.len()];
            view.predict_into(STATE, &times, auto, &mut values);
            (times, values)
        };
        let (middles, of_hours) = predict(hours);
        let hours = LEVELS.map(|level| view.intervals(STATE, (middles.moments(), &of_hours), auto, Some(level)));
        DayAhead { values: predict(times).1, hours }
    }

    /// Learns the readings of a day at the midnight that ends it.
    pub(super) fn learn(&mut self, looks: &[Look], midnight_nanos: i64) -> Result<(), HabitsError> {
        if looks.is_empty() {
            return Ok(());
        }
        let mut observed = Observations::default();
        for look in looks {
            observed.push(STATE, look.sample);
        }
        self.0.observe(observed, looks.len() as u64, midnight_nanos)?;
        self.0.update(midnight_nanos)
    }
}
