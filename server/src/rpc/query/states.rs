//! `PredictStates` and `DescribeModel`: predictions of states and cells at many times, and the model of one.
//!
//! Invariant: replies come by state, then by time. If all times are one block, its phasors are computed once for all
//! states and cells, and again after a longer wait. A reply that waits for its reader keeps no phasors in memory.
//! Requests for existing models do not wait for a fit.

use std::{ops::Range, sync::Arc};

use tidemap_grid::index::CellIndex;
use tidemap_map::{
    event::{StateKind, StateShape},
    predict::PreparedTimes,
    view::MapView,
};
use tidemap_model::{
    Persistence, direction_rad, entropy_bits,
    models::{Interval, Moment},
    selector::ModelSelector,
};
use tidemap_proto::{
    convert::{
        InvalidField,
        cells::cell_description_to_wire,
        query::{description_to_wire, selector_from_wire, selector_to_wire},
        time::timestamp,
    },
    v1,
};

use super::{Queries, STATES_MAX};
use crate::{
    ingest::handle::MapHandle,
    model_cache::CachedModel,
    rpc::{
        fitting::LearnedState,
        lookup::{check_limit, find_all, find_map, find_published, opened},
        permits::run_blocking,
        replies::{Replies, ReplySink, compute_replies, stream_replies},
        series::FITTED_TIMES,
        status::RpcError,
    },
    state_or_cell::StateOrCell,
};

/// Times whose phasors are held at once: some 10 MB at 168 periodicities.
const TIMES_PER_BLOCK: usize = 4096;

/// A name of a request: its index, and for a vector the axis, 1 for x.
#[derive(Clone, Copy, Debug)]
struct StateAxis {
    state_index: usize,
    axis: u32,
    /// Whether it is the cosine or the sine of an angle, which follow one another and have one reply.
    is_angle: bool,
}

/// The names of a request, each vector and angle replaced by its axes.
fn by_axis(view: &MapView, names: Vec<String>) -> (Vec<StateAxis>, Vec<String>) {
    let mut places = Vec::with_capacity(names.len());
    let mut all = Vec::with_capacity(names.len());
    for (state_index, name) in names.into_iter().enumerate() {
        match view.shape(&name) {
            Some((_, shape @ (StateShape::Vector(_) | StateShape::Angle))) => {
                let is_angle = shape == StateShape::Angle;
                for (axis, letter) in (1..).zip(shape.axes()) {
                    places.push(StateAxis { state_index, axis: if is_angle { 0 } else { axis }, is_angle });
                    all.push(format!("{name}/{letter}"));
                }
            }
            _ => {
                places.push(StateAxis { state_index, axis: 0, is_angle: false });
                all.push(name);
            }
        }
    }
    (places, all)
}

/// Whether a view has the state or the cell of this name.
fn is_in(view: &MapView, name: &str) -> bool {
    let Some(Ok(cell)) = CellIndex::from_name(name) else { return view.shape(name).is_some() };
    let (tile, place) = cell.tile();
    let live = view.grid().and_then(|grid| grid.live(grid.find(tile)?));
    live.is_some_and(|live| live.known.contains(place))
}

pub(super) async fn predict_states(
    queries: &Queries,
    request: v1::PredictStatesRequest,
) -> Result<Replies<v1::PredictStatesResponse>, RpcError> {
    let handle = find_published(&queries.catalog, &request.map)?;
    let is_published = selector_from_wire("model", request.model)?.is_of_generation()
        && request.states.iter().all(|name| is_in(&handle.view(), name));
    if !is_published {
        opened(&handle).await?;
    }
    let view = handle.view();
    if request.states.is_empty() {
        return Err(InvalidField::new("states", "name at least one state").into());
    }
    check_limit("states", request.states.len() as u64, STATES_MAX as u64, "one request")?;
    if request.times_nanos.is_empty() {
        return Err(InvalidField::new("times_nanos", "name at least one time").into());
    }
    if let Some(index) = request.times_nanos.iter().position(|&nanos| nanos < 0) {
        let text = format!("{} ns is before 1970", request.times_nanos[index]);
        return Err(InvalidField::new(format!("times_nanos[{index}]"), text).into());
    }
    let (places, names) = by_axis(&view, request.states);
    let predictions = names.len() as u64 * request.times_nanos.len() as u64;
    check_limit("predictions", predictions, queries.max_predictions, "setting max_predictions")?;
    let selector = selector_from_wire("model", request.model)?;
    let level = request.interval_level;
    if !(0.0..1.0).contains(&level) {
        let text = format!("{level} is not a probability: 0 (no intervals) or more, and below 1");
        return Err(InvalidField::new("interval_level", text).into());
    }
    let states: Vec<usize> = places.iter().map(|place| place.state_index).collect();
    let field = move |i: usize| format!("states[{}]", states.get(i).copied().unwrap_or_default());
    if selector.kind.needs_readings() {
        let subjects = places.into_iter().zip(find_all(&view, field, names).await?).collect();
        return Ok(predict_fitted(queries, handle, view, subjects, &request.times_nanos, (selector, level)));
    }
    // Held while cells are read from the disk, too. An interval costs about as much as thirteen predictions.
    let permit = queries.permit_for(if level > 0.0 { 13 * predictions } else { predictions }).await?;
    let named: Vec<(StateAxis, StateOrCell)> = places.into_iter().zip(find_all(&view, field, names).await?).collect();
    Ok(compute_replies(vec![permit], move |sink| {
        predict(&view, &named, &request.times_nanos, (selector, level), sink);
        Ok(())
    }))
}

/// Predicts by models that are fitted to the readings of states and cells, one after the other. The permit is free
/// during a fit.
fn predict_fitted(
    queries: &Queries,
    handle: Arc<MapHandle>,
    view: Arc<MapView>,
    subjects: Vec<(StateAxis, StateOrCell)>,
    times_nanos: &[i64],
    (selector, level): (ModelSelector, f64),
) -> Replies<v1::PredictStatesResponse> {
    let (fitting, permits) = (Arc::clone(&queries.fitting), queries.large_permits.clone());
    let moments: Arc<[Moment]> = view.moments(times_nanos).into();
    stream_replies(move |sink| async move {
        let mut cosine = None;
        for (place, subject) in subjects {
            let learned = LearnedState::new(Arc::clone(&handle), Arc::clone(&view), subject.clone());
            let fitted = tokio::select! {
                () = sink.closed() => return Ok(()),
                fitted = fitting.fitted(&learned, selector.kind) => fitted?,
            };
            if place.is_angle && cosine.is_none() {
                cosine = Some((subject, fitted));
                continue;
            }
            let sources: Vec<_> = cosine.take().into_iter().chain([(subject, fitted)]).collect();
            let (view, moments) = (Arc::clone(&view), Arc::clone(&moments));
            let sink = sink.clone().holding(vec![permits.take().await?]);
            let predict = move || predict_one(&view, (place, &sources), &moments, (selector, level), &sink);
            if !run_blocking((), predict).await? {
                break;
            }
        }
        Ok(())
    })
}

/// Predicts one state by a fitted model, or an angle by those of its cosine and its sine. `false`: the client is gone.
fn predict_one(
    view: &MapView,
    (place, sources): (StateAxis, &[(StateOrCell, Arc<CachedModel>)]),
    moments: &[Moment],
    (selector, level): (ModelSelector, f64),
    sink: &ReplySink<v1::PredictStatesResponse>,
) -> bool {
    let mut blocks = moments.chunks(TIMES_PER_BLOCK).enumerate();
    blocks.all(|(block, moments)| {
        let forecast = sources.iter().map(|(subject, fitted)| {
            let mut values = vec![0.0; moments.len()];
            for (moments, values) in moments.chunks(FITTED_TIMES).zip(values.chunks_mut(FITTED_TIMES)) {
                if !sink.is_closed() {
                    fitted.predict_into(view, subject, moments, selector, values);
                }
            }
            let level = Some(level).filter(|&level| level > 0.0 && !place.is_angle);
            let intervals = subject.intervals(view, moments, &values, level);
            Forecast { values, intervals, about: About::of(view, subject, selector) }
        });
        let Some(forecast) = forecast.reduce(Forecast::angle) else { return false };
        sink.send(reply(place, block * TIMES_PER_BLOCK, forecast))
    })
}

/// Computes the replies until all are sent or the client is gone.
fn predict(
    view: &MapView,
    named: &[(StateAxis, StateOrCell)],
    times_nanos: &[i64],
    (selector, level): (ModelSelector, f64),
    sink: &ReplySink<v1::PredictStatesResponse>,
) {
    let blocks = blocks(times_nanos.len());
    // The block whose phasors are at hand.
    let mut at_hand: Option<(usize, PreparedTimes)> = None;
    // The cosine and the sine of an angle are neighbours.
    for subjects in named.chunk_by(|(one, _), (other, _)| one.is_angle && one.state_index == other.state_index) {
        let Some((place, _)) = subjects.first() else { continue };
        for block in &blocks {
            let known = at_hand.take().filter(|(start, _)| *start == block.start);
            let (_, prepared) =
                at_hand.insert(known.unwrap_or_else(|| (block.start, view.prepare(&times_nanos[block.clone()]))));
            let level = Some(level).filter(|&level| level > 0.0 && !place.is_angle);
            let forecast = subjects.iter().map(|(_, subject)| forecast(view, subject, prepared, selector, level));
            let Some(forecast) = forecast.reduce(Forecast::angle) else { continue };
            if !sink.send_freeing(reply(*place, block.start, forecast), || at_hand = None) {
                return;
            }
        }
    }
}

fn forecast(
    view: &MapView,
    subject: &StateOrCell,
    prepared: &PreparedTimes,
    selector: ModelSelector,
    level: Option<f64>,
) -> Forecast {
    let mut values = vec![0.0; prepared.moments().len()];
    subject.predict_into(view, prepared, selector, &mut values);
    let intervals = subject.intervals(view, prepared.moments(), &values, level);
    Forecast { values, intervals, about: About::of(view, subject, selector) }
}

/// Blocks of times.
fn blocks(times: usize) -> Vec<Range<usize>> {
    (0..times).step_by(TIMES_PER_BLOCK).map(|start| start..times.min(start + TIMES_PER_BLOCK)).collect()
}

/// The other facts of a reply: the state's kind, the order of its model, its observations and its last value.
struct About {
    kind: StateKind,
    order: usize,
    observations: u64,
    pending: u64,
    /// Absent: nothing was learned, and the prior predicts.
    answered_by: Option<ModelSelector>,
    persistence: Persistence,
}

impl About {
    fn of(view: &MapView, subject: &StateOrCell, selector: ModelSelector) -> About {
        About {
            kind: subject.kind(view),
            order: subject.order(view, selector),
            observations: subject.observations(view),
            pending: subject.observations(view).saturating_sub(subject.learned(view)),
            answered_by: subject.answered_by(view, selector),
            persistence: subject.persistence(view),
        }
    }
}

/// Predictions of one state at a block of times.
struct Forecast {
    values: Vec<f64>,
    /// Empty if none were requested.
    intervals: Vec<Interval>,
    about: About,
}

impl Forecast {
    /// The angle whose cosine and sine these are: the direction of both, without intervals.
    fn angle(cosine: Forecast, sine: Forecast) -> Forecast {
        let pairs = cosine.values.into_iter().zip(sine.values);
        let about = About { order: cosine.about.order.max(sine.about.order), ..cosine.about };
        Forecast { values: pairs.map(|(cos, sin)| direction_rad([cos, sin])).collect(), intervals: Vec::new(), about }
    }
}

/// Predictions of one state.
fn reply(
    place: StateAxis,
    first_time_index: usize,
    Forecast { values, intervals, about: About { kind, order, observations, pending, answered_by, persistence } }: Forecast,
) -> v1::PredictStatesResponse {
    v1::PredictStatesResponse {
        state_index: u32::try_from(place.state_index).unwrap_or(u32::MAX),
        first_time_index: u32::try_from(first_time_index).unwrap_or(u32::MAX),
        entropies_bits: match kind {
            StateKind::Probability => values.iter().map(|&probability| entropy_bits(probability)).collect(),
            StateKind::Continuous | StateKind::Count => Vec::new(),
        },
        probabilities: values,
        lower: intervals.iter().map(|interval| interval.lower).collect(),
        upper: intervals.iter().map(|interval| interval.upper).collect(),
        order: u32::try_from(order).unwrap_or(u32::MAX),
        observations,
        last_time: persistence.last().map(|(nanos, _)| timestamp(nanos)),
        axis: place.axis,
        pending,
        answered_by: answered_by.map(selector_to_wire),
    }
}

pub(super) async fn describe_model(
    queries: &Queries,
    request: v1::DescribeModelRequest,
) -> Result<v1::DescribeModelResponse, RpcError> {
    let view = find_map(&queries.catalog, &request.map).await?.view();
    let _permit = queries.permits.take().await?;
    let mut found = find_all(&view, |_| "state".to_owned(), vec![request.state]).await?;
    Ok(match found.pop() {
        Some(StateOrCell::State(id)) => description_to_wire(&view, id).unwrap_or_default(),
        Some(StateOrCell::Cell(cell)) => cell_description_to_wire(&view, cell.index, &cell.description),
        None => v1::DescribeModelResponse::default(),
    })
}
