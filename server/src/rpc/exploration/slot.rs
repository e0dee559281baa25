//! `PlanSlot`: where to observe in the slot that begins now.
//!
//! Invariant: the location is one of the given ones, and the decision is based on one view.

use tidemap_map::view::MapView;
use tidemap_model::selector::{ModelKind, ModelSelector};
use tidemap_plan::{
    day::{DayError, DaySlots},
    location::{error_gain, information_bits, surprise_bits},
    strategy::{self, Gains, Strategy},
};
use tidemap_proto::{
    convert::{
        InvalidField,
        exploration::{allowance_from_wire, certainty_from_wire, slot_from_wire},
        query::selector_from_wire,
        time::instant_from_wire,
    },
    v1,
};

use super::{Explorations, day::locations, presence::predict_presence};
use crate::{
    rpc::{
        lookup::find_map,
        series::predict_series,
        status::{PlanError, RpcError},
    },
    state_or_cell::StateOrCell,
};

pub(super) async fn plan_slot(
    explorations: &Explorations,
    request: v1::PlanSlotRequest,
) -> Result<v1::PlanSlotResponse, RpcError> {
    let handle = find_map(&explorations.catalog, &request.map).await?;
    let view = handle.view();
    let time_nanos = instant_from_wire("time", request.time)?;
    let unknown = |_| InvalidField::new("strategy", format!("{} is not known", request.strategy));
    let wanted = v1::SlotStrategy::try_from(request.strategy).map_err(unknown)?;
    let is_novelty = wanted == v1::SlotStrategy::Novelty;
    let selector = match request.model {
        Some(model) => selector_from_wire("model", Some(model))?,
        None => ModelSelector { persistence: !is_novelty, ..ModelSelector::default() },
    };
    if request.exactly_one && request.model.is_some() {
        return Err(InvalidField::new("exactly_one", "it is a model itself: leave out model").into());
    }
    let certainty = certainty_from_wire("certainty", request.certainty)?;
    let (names, by_location) = locations(&view, request.locations, explorations.limits.predictions).await?;
    let planned = names.iter().position(|name| *name == request.planned);
    if is_novelty && planned.is_none() {
        let text = format!("{:?} is not one of the locations: name the one that is planned", request.planned);
        return Err(InvalidField::new("planned", text).into());
    }
    if !is_novelty && !request.planned.is_empty() {
        return Err(InvalidField::new("planned", "`planned` needs strategy NOVELTY: leave it empty").into());
    }
    let states: Vec<StateOrCell> = by_location.iter().flatten().cloned().collect();
    let ask = |times, selector| {
        predict_series(explorations.predict_context(), &handle, &view, (states.clone(), times), selector)
    };
    let slot_nanos = slot_from_wire(request.slot)?;
    let allowed = match allowance_from_wire(request.allowance) {
        None if request.spent > 0 || (request.slot.is_some() && !request.exactly_one) => {
            let text = "spent and slot are used only with an allowance: give explore or ratio";
            return Err(InvalidField::new("allowance", text).into());
        }
        None => None,
        Some(_) if !matches!(wanted, v1::SlotStrategy::Online | v1::SlotStrategy::OnlineError) => {
            let text = "only the strategies online and online-error go by an allowance";
            return Err(InvalidField::new("allowance", text).into());
        }
        Some(budget) => {
            let slots = day_slots(&view, time_nanos, slot_nanos)?;
            let visits = budget.visits(slots.count()).map_err(|error| PlanError::from(DayError::from(error)))?;
            Some((visits.saturating_sub(request.spent as usize), later(&slots, time_nanos)))
        }
    };
    // The slot itself, then the later ones of the day.
    let mut times = vec![time_nanos];
    times.extend(allowed.iter().flat_map(|(_, later)| later));
    let rows = if request.exactly_one {
        day_slots(&view, time_nanos, slot_nanos)?;
        let of = (names.as_slice(), by_location.as_slice());
        predict_presence(explorations, &handle, &view, of, (slot_nanos, times)).await?
    } else {
        ask(times, selector).await?
    };
    let at = |time: usize| split(rows.iter().map(|row| row[time]), &by_location);
    let informed = at(0);
    let gain = |_, place: usize| certainty.bits_of(informed[place].iter().copied());
    let gains = Gains::of(1, names.len(), gain).map_err(|error| PlanError::from(DayError::from(error)))?;
    let now = gains.slot(0);
    let mut surprise = 0.0;
    let chosen = match wanted {
        v1::SlotStrategy::Novelty => {
            let chain = ModelSelector { kind: ModelKind::Persistence, ..ModelSelector::default() };
            let expected = ask(vec![time_nanos], chain).await?;
            let expected = split(expected.iter().flatten().copied(), &by_location);
            let pairs = |place: usize| expected[place].iter().copied().zip(informed[place].iter().copied());
            let worth = |place| (surprise_bits(pairs(place)), information_bits(informed[place].iter().copied()));
            let chosen = strategy::novel((0..names.len()).map(worth)).or(planned);
            surprise = chosen.map_or(0.0, |place| worth(place).0);
            chosen
        }
        v1::SlotStrategy::MonteCarlo => Some(strategy::choose(Strategy::MonteCarlo, 0, now, request.seed)),
        v1::SlotStrategy::Unspecified | v1::SlotStrategy::Online | v1::SlotStrategy::OnlineError => {
            let values = |known: &[Vec<f64>]| -> Vec<f64> {
                let value = |states: &Vec<f64>| match wanted {
                    v1::SlotStrategy::OnlineError => error_gain(states.iter().copied()),
                    _ => certainty.bits_of(states.iter().copied()),
                };
                known.iter().map(value).collect()
            };
            let best = strategy::best(&values(&informed), request.seed);
            if let (Some((left, later)), Some((_, value))) = (&allowed, best) {
                let best_of = |time: usize| values(&at(time)).into_iter().fold(0.0, f64::max);
                let later: Vec<f64> = (1..=later.len()).map(best_of).collect();
                if !strategy::is_worth_a_visit(value, &later, *left) {
                    return Ok(v1::PlanSlotResponse::default());
                }
            }
            best.map(|(place, _)| place)
        }
    };
    let place = chosen.unwrap_or_default();
    Ok(v1::PlanSlotResponse {
        location: names.get(place).cloned().unwrap_or_default(),
        information_bits: gains.at(0, place),
        surprise_bits: surprise,
    })
}

/// The slots of the local day of a time.
fn day_slots(view: &MapView, time_nanos: i64, slot_nanos: i64) -> Result<DaySlots, RpcError> {
    let day = view.sample_maker()(time_nanos, 0.0).local_day();
    Ok(DaySlots::of(&view.spec().zone, day, slot_nanos).map_err(PlanError::from)?)
}

/// The middles of the slots that begin after a time, in nanoseconds UTC.
fn later(slots: &DaySlots, time_nanos: i64) -> Vec<i64> {
    let starts_later = |&slot: &usize| slots.start_nanos(slot) > time_nanos;
    (0..slots.count()).filter(starts_later).map(|slot| slots.middle_nanos(slot)).collect()
}

/// The probabilities of each location's states, given one for each state, location by location.
fn split(probabilities: impl Iterator<Item = f64>, by_location: &[Vec<StateOrCell>]) -> Vec<Vec<f64>> {
    let mut rest = probabilities;
    by_location.iter().map(|states| rest.by_ref().take(states.len()).collect()).collect()
}
