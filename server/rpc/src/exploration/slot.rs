//! `PlanSlot`: where to observe in the slot that begins now.
//!
//! Invariant: the location is one of the given ones, and the decision is based on one view.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_ingest::handle::MapHandle;
use tidemap_map::view::MapView;
use tidemap_model::selector::{ModelKind, ModelSelector};
use tidemap_plan::{
    day::{DayError, DaySlots},
    location::{error_gain, information_bits, surprise_bits},
    strategy::{self, Gains, Strategy},
};
use tidemap_proto::{
    convert::exploration::{
        LocationChoice, PlannedSlot, SlotAllowance, SlotModels, SlotQuestion, planned_slot_to_wire,
        slot_question_from_wire,
    },
    v1,
};

use super::{
    Explorations,
    locations::{Locations, find_locations},
    presence::predict_presence,
    worth::look_worths,
};
use crate::{
    lookup::find_map,
    series::predict_series,
    status::{Misfit, PlanError, Problem, RpcError},
};

pub(super) async fn plan_slot(
    explorations: &Explorations,
    request: v1::PlanSlotRequest,
) -> Result<v1::PlanSlotResponse, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let question = slot_question_from_wire(request)?;
    let view = handle.view();
    let locations = find_locations(&view, &question.locations, explorations.limits.predictions).await?;
    let planned = planned_place(&question.choice, &locations.names)?;
    let visits = question.allowance.map(|allowance| VisitsLeft::of(&view, &question, allowance)).transpose()?;
    let slot = Slot { explorations, handle: &handle, view: &view, question: &question, locations: &locations };
    let forecast = slot.predict(visits.as_ref()).await?;
    let now = forecast.at(0);
    let bits = forecast.bits_at(0);
    let gain = |_, place: usize| bits[place].iter().sum();
    let gains = Gains::of(1, now.len(), gain).map_err(|error| PlanError::from(DayError::from(error)))?;
    let (place, surprise_bits) = match question.choice {
        LocationChoice::Novelty { .. } => slot.most_novel(&now, planned).await?,
        LocationChoice::MonteCarlo => (strategy::choose(Strategy::MonteCarlo, 0, gains.slot(0), question.seed), 0.0),
        LocationChoice::Information | LocationChoice::Error => match best_now(&question, &forecast, visits.as_ref()) {
            Some(place) => (place, 0.0),
            // The robot rests.
            None => return Ok(planned_slot_to_wire(None)),
        },
    };
    let location = locations.names.get(place).cloned().unwrap_or_default();
    let planned = PlannedSlot { location, information_bits: gains.at(0, place), surprise_bits };
    Ok(planned_slot_to_wire(Some(planned)))
}

/// The place of the planned location, if the choice needs one.
fn planned_place(choice: &LocationChoice, names: &[String]) -> Result<Option<usize>, Misfit> {
    let LocationChoice::Novelty { planned } = choice else { return Ok(None) };
    let place = names.iter().position(|name| name == planned);
    place.map(Some).ok_or_else(|| Problem::NotPlanned { planned: planned.clone() }.of("planned"))
}

/// The visits and slots that a day has left.
struct VisitsLeft {
    visits: usize,
    /// The middles of the later slots of the day, nanoseconds UTC.
    later_nanos: Vec<i64>,
}

impl VisitsLeft {
    fn of(view: &MapView, question: &SlotQuestion, allowance: SlotAllowance) -> Result<Self, RpcError> {
        let slots = day_slots(view, question)?;
        let visits = allowance.budget.visits(slots.count()).map_err(|error| PlanError::from(DayError::from(error)))?;
        let starts_later = |&slot: &usize| slots.start_nanos(slot) > question.time_nanos;
        let later_nanos = (0..slots.count()).filter(starts_later).map(|slot| slots.middle_nanos(slot)).collect();
        Ok(Self { visits: visits.saturating_sub(allowance.spent), later_nanos })
    }
}

/// The slots of the local day of a question.
fn day_slots(view: &MapView, question: &SlotQuestion) -> Result<DaySlots, PlanError> {
    let day = view.sample_maker()(question.time_nanos, 0.0).local_day();
    Ok(DaySlots::of(&view.spec().zone, day, question.slot_nanos)?)
}

/// A question about a slot, and the locations of a view to choose from.
struct Slot<'a> {
    explorations: &'a Explorations,
    handle: &'a Arc<MapHandle>,
    view: &'a Arc<MapView>,
    question: &'a SlotQuestion,
    locations: &'a Locations,
}

impl Slot<'_> {
    /// The forecast of the slot itself and, if visits are limited, of the later slots of the day.
    async fn predict(&self, visits: Option<&VisitsLeft>) -> Result<SlotForecast<'_>, RpcError> {
        let mut times = vec![self.question.time_nanos];
        times.extend(visits.into_iter().flat_map(|visits| &visits.later_nanos));
        if !self.question.exactly_one {
            let rows = self.series(&times, self.question.models).await?;
            return self.forecast(&times, rows).await;
        }
        day_slots(self.view, self.question)?;
        let slot_nanos = self.question.slot_nanos;
        let slot_times = (slot_nanos, times.clone());
        let rows = predict_presence(self.explorations, self.handle, self.view, self.locations, slot_times).await?;
        self.forecast(&times, rows).await
    }

    /// The states and cells of all locations, in the order of the locations.
    fn states(&self) -> Vec<StateOrCell> {
        self.locations.members.iter().flatten().cloned().collect()
    }

    async fn forecast(&self, times: &[i64], rows: Vec<Vec<f64>>) -> Result<SlotForecast<'_>, RpcError> {
        let requested = (self.states(), times);
        let bits = look_worths(self.explorations, self.view, requested, &rows, self.question.worth).await?;
        Ok(SlotForecast { rows, bits, members: &self.locations.members })
    }

    /// The predictions of all states and cells at times, a row each, in the order of the locations.
    async fn series(&self, times: &[i64], models: SlotModels) -> Result<Vec<Vec<f64>>, RpcError> {
        let all = self.states();
        let is_cell = |member: &&StateOrCell| matches!(member, StateOrCell::Cell(_));
        let (cells, states): (Vec<_>, Vec<_>) = all.iter().cloned().partition(|member| is_cell(&member));
        let context = || self.explorations.predict_context();
        let predict =
            |members, model| predict_series(context(), self.handle, self.view, (members, times.to_vec()), model);
        let (of_cells, of_states) = (predict(cells, models.cells).await?, predict(states, models.states).await?);
        let (mut of_cells, mut of_states) = (of_cells.into_iter(), of_states.into_iter());
        let row = |member: &StateOrCell| if is_cell(&member) { of_cells.next() } else { of_states.next() };
        Ok(all.iter().map(row).map(Option::unwrap_or_default).collect())
    }

    /// The most surprising location, or the planned one if none is surprising enough, with its surprise in bits. `now`
    /// has the probabilities of the states of each location.
    async fn most_novel(&self, now: &[Vec<f64>], planned: Option<usize>) -> Result<(usize, f64), RpcError> {
        let chain = ModelSelector { kind: ModelKind::Persistence, ..ModelSelector::default() };
        let chains = SlotModels { states: chain, cells: chain };
        let rows = self.series(&[self.question.time_nanos], chains).await?;
        let expected = of_locations(&rows, &self.locations.members, 0);
        let pairs = |place: usize| expected[place].iter().copied().zip(now[place].iter().copied());
        let worth = |place| (surprise_bits(pairs(place)), information_bits(now[place].iter().copied()));
        let place = strategy::novel((0..now.len()).map(worth)).or(planned).unwrap_or_default();
        Ok((place, worth(place).0))
    }
}

/// The predictions of the states of locations at the times of a question.
struct SlotForecast<'a> {
    /// A row per state, in the order of the locations, with a probability per time.
    rows: Vec<Vec<f64>>,
    /// The worth of an observation in bits, in rows of the same form.
    bits: Vec<Vec<f64>>,
    members: &'a [Vec<StateOrCell>],
}

impl SlotForecast<'_> {
    /// The probabilities of each location's states at a time, by the index of the time.
    fn at(&self, time: usize) -> Vec<Vec<f64>> {
        of_locations(&self.rows, self.members, time)
    }

    /// The worth of an observation of each location's states at a time, by the index of the time.
    fn bits_at(&self, time: usize) -> Vec<Vec<f64>> {
        of_locations(&self.bits, self.members, time)
    }
}

/// The values of each location's states at a time, by the index of the time. `rows` has a row per state, in the order
/// of the locations.
fn of_locations(rows: &[Vec<f64>], members: &[Vec<StateOrCell>], time: usize) -> Vec<Vec<f64>> {
    let mut rest = rows.iter().map(|row| row[time]);
    members.iter().map(|states| rest.by_ref().take(states.len()).collect()).collect()
}

/// The location that is worth most now; `None` if enough later slots are worth more.
fn best_now(question: &SlotQuestion, forecast: &SlotForecast<'_>, visits: Option<&VisitsLeft>) -> Option<usize> {
    let values = |time: usize| -> Vec<f64> {
        match question.choice {
            LocationChoice::Error => {
                forecast.at(time).iter().map(|states| error_gain(states.iter().copied())).collect()
            }
            _ => forecast.bits_at(time).iter().map(|bits| bits.iter().sum()).collect(),
        }
    };
    let Some((place, worth)) = strategy::best(&values(0), question.seed) else { return Some(0) };
    let Some(VisitsLeft { visits, later_nanos }) = visits else { return Some(place) };
    let best_of = |time: usize| values(time).into_iter().fold(0.0, f64::max);
    let later: Vec<f64> = (1..=later_nanos.len()).map(best_of).collect();
    strategy::is_worth_a_visit(worth, &later, *visits).then_some(place)
}
