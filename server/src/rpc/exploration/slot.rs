//! `PlanSlot`: where to observe in the slot that begins now.
//!
//! Invariant: the location is one of the given ones, and the decision is based on one view.

use tidemap_map::selector::{ModelKind, ModelSelector};
use tidemap_plan::{
    day::DayError,
    location::{information_bits, surprise_bits},
    strategy::{self, Gains, Strategy},
};
use tidemap_proto::{
    convert::{InvalidField, exploration::certainty_from_wire, query::selector_from_wire, time::instant_from_wire},
    v1,
};

use super::{Explorations, day::locations, error::PlanError};
use crate::{
    rpc::{lookup::find_map, series::predict_series, status::RpcError},
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
    let certainty = certainty_from_wire("certainty", request.certainty)?;
    let (names, by_location) = locations(&view, request.locations, explorations.limits.predictions).await?;
    let planned = names.iter().position(|name| *name == request.planned);
    if is_novelty && planned.is_none() {
        let text = format!("{:?} is not one of the locations: name the one that is planned", request.planned);
        return Err(InvalidField::new("planned", text).into());
    }
    if !is_novelty && !request.planned.is_empty() {
        return Err(InvalidField::new("planned", "only the novelty-driven strategy goes by a plan").into());
    }
    let states: Vec<StateOrCell> = by_location.iter().flatten().cloned().collect();
    let ask = |selector| {
        predict_series(explorations.predict_context(), &handle, &view, (states.clone(), vec![time_nanos]), selector)
    };
    let informed = ask(selector).await?;
    let informed = split(&informed, &by_location);
    let gain = |_, place: usize| certainty.bits_of(informed[place].iter().copied());
    let gains = Gains::of(1, names.len(), gain).map_err(|error| PlanError::from(DayError::from(error)))?;
    let now = gains.slot(0);
    let mut surprise = 0.0;
    let chosen = match wanted {
        v1::SlotStrategy::Novelty => {
            let chain = ModelSelector { kind: ModelKind::Persistence, ..ModelSelector::default() };
            let expected = ask(chain).await?;
            let expected = split(&expected, &by_location);
            let pairs = |place: usize| expected[place].iter().copied().zip(informed[place].iter().copied());
            let worth = |place| (surprise_bits(pairs(place)), information_bits(informed[place].iter().copied()));
            let chosen = strategy::novel((0..names.len()).map(worth)).or(planned);
            surprise = chosen.map_or(0.0, |place| worth(place).0);
            chosen
        }
        v1::SlotStrategy::MonteCarlo => Some(strategy::choose(Strategy::MonteCarlo, 0, now, request.seed)),
        v1::SlotStrategy::Unspecified | v1::SlotStrategy::Online => {
            strategy::best(now, request.seed).map(|(place, _)| place)
        }
    };
    let place = chosen.unwrap_or_default();
    Ok(v1::PlanSlotResponse {
        location: names.get(place).cloned().unwrap_or_default(),
        information_bits: gains.at(0, place),
        surprise_bits: surprise,
    })
}

/// The probabilities of each location's states. `rows` has one for each state, location by location.
fn split(rows: &[Vec<f64>], by_location: &[Vec<StateOrCell>]) -> Vec<Vec<f64>> {
    let mut rest = rows.iter().flatten().copied();
    by_location.iter().map(|states| rest.by_ref().take(states.len()).collect()).collect()
}
