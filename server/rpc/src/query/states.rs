//! `PredictStates` and `DescribeModel`: predictions of states and cells at many times, and the model of one.
//!
//! Invariant: replies come by state, then by time. If all times are one block, its phasors are computed once for all
//! states and cells, and again after a longer wait. A reply that waits for its reader keeps no phasors in memory.
//! Requests for existing models do not wait for a training.

use std::{ops::Range, sync::Arc};

use tidemap_answer::{CachedModel, StateOrCell};
use tidemap_grid::index::CellIndex;
use tidemap_ingest::handle::MapHandle;
use tidemap_map::{event::StateShape, predict::PreparedTimes, view::MapView};
use tidemap_model::{
    HeldInterval, deviation_of_direction_rad, direction_rad,
    models::{Interval, Moment},
    selector::ModelSelector,
};
use tidemap_proto::{
    convert::{
        cells::cell_description_to_wire,
        labels::label_forecasts_to_wire,
        query::{StateFacts, StateForecast, StatesQuestion, description_to_wire, forecast_to_wire, states_from_wire},
    },
    v1,
};

use super::{Queries, STATES_MAX};
use crate::{
    lookup::{check_limit, find_all, find_map, find_published, opened},
    permits::run_blocking,
    replies::{Replies, ReplySink, compute_replies, stream_replies},
    series::{TRAINED_TIMES, check_published},
    status::RpcError,
    training::LearnedState,
};

/// Number of times whose phasors are held at once: some 10 MB at 168 periodicities.
const TIMES_PER_BLOCK: usize = 4096;

/// The kind of a part of a name; its replies depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PartKind {
    /// The part is the whole state.
    Alone,
    /// The cosine and the sine of an angle, which follow one another and have one reply.
    Angle,
    /// All labels of a categorical state, which follow one another and have a reply each.
    Label,
}

/// A part of a name of a request: the index of the name, and for a vector the axis, 1 for x.
#[derive(Clone, Copy, Debug)]
struct StateAxis {
    state_index: usize,
    axis: u32,
    kind: PartKind,
    /// Whether no other part of the name follows.
    is_last: bool,
}

/// The names of a request, each vector and angle replaced by its axes, and each categorical state by its labels.
struct NamedAxes {
    axes: Vec<StateAxis>,
    names: Vec<String>,
}

impl NamedAxes {
    fn of(view: &MapView, names: &[String]) -> Self {
        let mut found = Self { axes: Vec::with_capacity(names.len()), names: Vec::with_capacity(names.len()) };
        for (state_index, name) in names.iter().enumerate() {
            match view.shape(name) {
                Some((_, shape @ (StateShape::Vector(_) | StateShape::Angle))) => {
                    let kind = if shape == StateShape::Angle { PartKind::Angle } else { PartKind::Alone };
                    found.push(state_index, name, shape.axes(), kind);
                }
                Some((_, StateShape::Categorical(_))) => {
                    let labels: Vec<&str> = view.labels(name).into_iter().map(|(_, label)| label).collect();
                    found.push(state_index, name, &labels, PartKind::Label);
                }
                _ => {
                    found.axes.push(StateAxis { state_index, axis: 0, kind: PartKind::Alone, is_last: true });
                    found.names.push(name.clone());
                }
            }
        }
        found
    }

    fn push(&mut self, state_index: usize, name: &str, parts: &[&str], kind: PartKind) {
        for (number, part) in (1..).zip(parts) {
            let axis = if kind == PartKind::Angle { 0 } else { number };
            let is_last = number as usize == parts.len();
            self.axes.push(StateAxis { state_index, axis, kind, is_last });
            self.names.push(format!("{name}/{part}"));
        }
    }

    /// The state or cell of each axis.
    async fn find(self, view: &Arc<MapView>) -> Result<Vec<(StateAxis, StateOrCell)>, RpcError> {
        let indices: Vec<usize> = self.axes.iter().map(|axis| axis.state_index).collect();
        let field = move |i: usize| format!("states[{}]", indices.get(i).copied().unwrap_or_default());
        Ok(self.axes.into_iter().zip(find_all(view, field, self.names).await?).collect())
    }
}

/// Whether a view has the state or the cell with this name.
fn is_in(view: &MapView, name: &str) -> bool {
    let Some(Ok(cell)) = CellIndex::from_name(name) else { return view.shape(name).is_some() };
    let (tile, place) = cell.tile();
    let live = view.grid().and_then(|grid| grid.live(grid.find(tile)?));
    live.is_some_and(|live| live.known.contains(place))
}

/// The view that answers: while the map is opened, the view of the index, if it has all states and cells of the
/// question.
async fn view_for(handle: &MapHandle, question: &StatesQuestion) -> Result<Arc<MapView>, RpcError> {
    let view = handle.view();
    let selector = question.selector;
    // The newest value of a cell is not part of its default model.
    let is_default_cell = |name: &str| selector.knows_newest() && CellIndex::from_name(name).is_some();
    let is_published = |name: &str| selector.is_of_generation() || is_default_cell(name);
    if question.names.iter().all(|name| is_published(name) && is_in(&view, name)) {
        return Ok(view);
    }
    opened(handle).await?;
    Ok(handle.view())
}

pub(super) async fn predict_states(
    queries: &Queries,
    request: v1::PredictStatesRequest,
) -> Result<Replies<v1::PredictStatesResponse>, RpcError> {
    let handle = find_published(&queries.catalog, &request.map)?;
    let question = states_from_wire(request)?;
    check_limit("states", question.names.len() as u64, STATES_MAX as u64, "one request")?;
    let view = view_for(&handle, &question).await?;
    let axes = NamedAxes::of(&view, &question.names);
    let predictions = axes.names.len() as u64 * question.times_nanos.len() as u64;
    check_limit("predictions", predictions, queries.max_predictions, "setting max_predictions")?;
    if question.selector.kind.needs_readings() {
        let subjects = axes.find(&view).await?;
        return Ok(predict_trained(queries, handle, view, subjects, &question));
    }
    // An interval costs about as much as thirteen predictions.
    let cost = if question.interval_level.is_some() { 13 * predictions } else { predictions };
    // The permit is held while cells are read from the disk, too.
    let permit = queries.permit_for(cost).await?;
    let subjects = axes.find(&view).await?;
    check_published(&view, subjects.iter().map(|(_, subject)| subject), question.selector.kind)?;
    Ok(compute_replies(vec![permit], move |sink| {
        predict(&view, &subjects, &question, sink);
        Ok(())
    }))
}

/// Predicts by models that are trained on the readings of states and cells, one after the other. The permit is free
/// during a training.
fn predict_trained(
    queries: &Queries,
    handle: Arc<MapHandle>,
    view: Arc<MapView>,
    subjects: Vec<(StateAxis, StateOrCell)>,
    question: &StatesQuestion,
) -> Replies<v1::PredictStatesResponse> {
    let (trainer, permits) = (Arc::clone(&queries.trainer), queries.large_permits.clone());
    let moments: Arc<[Moment]> = view.moments(&question.times_nanos).into();
    let StatesQuestion { selector, interval_level, .. } = *question;
    stream_replies(move |sink| async move {
        let mut sources = Vec::new();
        for (axis, subject) in subjects {
            let learned = LearnedState::new(Arc::clone(&handle), Arc::clone(&view), subject.clone());
            let trained = tokio::select! {
                () = sink.closed() => return Ok(()),
                trained = trainer.trained(&learned, selector.kind) => trained?,
            };
            sources.push((subject, trained));
            if axis.kind != PartKind::Alone && !axis.is_last {
                continue;
            }
            let sources = std::mem::take(&mut sources);
            let (view, moments) = (Arc::clone(&view), Arc::clone(&moments));
            let sink = sink.clone().holding(vec![permits.take().await?]);
            let predict = move || predict_one(&view, (axis, &sources), &moments, (selector, interval_level), &sink);
            if !run_blocking((), predict).await? {
                break;
            }
        }
        Ok(())
    })
}

/// Predicts one state by a trained model, or an angle or a categorical state by those of its parts. Returns `false` if
/// the client is gone.
fn predict_one(
    view: &MapView,
    (axis, sources): (StateAxis, &[(StateOrCell, Arc<CachedModel>)]),
    moments: &[Moment],
    (selector, interval_level): (ModelSelector, Option<f64>),
    sink: &ReplySink<v1::PredictStatesResponse>,
) -> bool {
    let mut held = LabelReplies::default();
    let mut blocks = moments.chunks(TIMES_PER_BLOCK).enumerate();
    let is_open = blocks.all(|(block, moments)| {
        let forecasts = sources.iter().map(|(subject, trained)| {
            let mut values = vec![0.0; moments.len()];
            for (moments, values) in moments.chunks(TRAINED_TIMES).zip(values.chunks_mut(TRAINED_TIMES)) {
                if !sink.is_closed() {
                    trained.predict_into(view, subject, moments, selector, values);
                }
            }
            let intervals = subject.intervals(view, (moments, &values), selector, interval_level);
            StateForecast { values, intervals, facts: facts(view, subject, selector, moments) }
        });
        let first = block * TIMES_PER_BLOCK;
        if axis.kind == PartKind::Label {
            held.add(
                axis.state_index,
                first,
                sources.iter().map(|(subject, _)| label_of(view, subject)).zip(forecasts),
            );
            return !sink.is_closed();
        }
        let Some(forecast) = forecasts.reduce(angle) else { return false };
        sink.send(forecast_to_wire(axis.state_index, axis.axis, first, forecast))
    });
    is_open && held.by_label().all(|reply| sink.send(reply))
}

/// The replies for all labels of a state, which come by label and then by time, and are computed by time.
#[derive(Default)]
struct LabelReplies(Vec<Vec<v1::PredictStatesResponse>>);

impl LabelReplies {
    fn add(&mut self, state_index: usize, first: usize, forecasts: impl Iterator<Item = (String, StateForecast)>) {
        self.0.push(label_forecasts_to_wire(state_index, first, forecasts.collect()));
    }

    fn by_label(self) -> impl Iterator<Item = v1::PredictStatesResponse> {
        let labels = self.0.first().map_or(0, Vec::len);
        let mut blocks: Vec<_> = self.0.into_iter().map(Vec::into_iter).collect();
        (0..labels).flat_map(move |_| blocks.iter_mut().filter_map(Iterator::next).collect::<Vec<_>>())
    }
}

/// The label of a label's state.
fn label_of(view: &MapView, subject: &StateOrCell) -> String {
    let StateOrCell::State(id) = subject else { return String::new() };
    let label = view.info(*id).and_then(|info| info.name.as_label());
    label.map_or_else(String::new, |(_, label)| label.to_owned())
}

/// Computes the replies until all are sent or the client is gone.
fn predict(
    view: &MapView,
    named: &[(StateAxis, StateOrCell)],
    question: &StatesQuestion,
    sink: &ReplySink<v1::PredictStatesResponse>,
) {
    let StatesQuestion { ref times_nanos, selector, interval_level, .. } = *question;
    let blocks = blocks(times_nanos.len());
    // The block whose phasors are in memory.
    let mut at_hand: Option<(usize, PreparedTimes)> = None;
    // The parts of an angle or of a categorical state are neighbours.
    let is_joined =
        |one: &StateAxis, other: &StateAxis| one.kind != PartKind::Alone && one.state_index == other.state_index;
    for subjects in named.chunk_by(|(one, _), (other, _)| is_joined(one, other)) {
        let Some((axis, _)) = subjects.first() else { continue };
        let mut held = LabelReplies::default();
        for block in &blocks {
            let known = at_hand.take().filter(|(start, _)| *start == block.start);
            let (_, prepared) =
                at_hand.insert(known.unwrap_or_else(|| (block.start, view.prepare(&times_nanos[block.clone()]))));
            let forecasts =
                subjects.iter().map(|(_, subject)| forecast(view, subject, prepared, selector, interval_level));
            if axis.kind == PartKind::Label {
                let labels = subjects.iter().map(|(_, subject)| label_of(view, subject));
                held.add(axis.state_index, block.start, labels.zip(forecasts));
                continue;
            }
            let Some(forecast) = forecasts.reduce(angle) else { continue };
            let reply = forecast_to_wire(axis.state_index, axis.axis, block.start, forecast);
            if !sink.send_freeing(reply, || at_hand = None) {
                return;
            }
        }
        for reply in held.by_label() {
            if !sink.send_freeing(reply, || at_hand = None) {
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
) -> StateForecast {
    let mut values = vec![0.0; prepared.moments().len()];
    subject.predict_into(view, prepared, selector, &mut values);
    let intervals = subject.intervals(view, (prepared.moments(), &values), selector, level);
    StateForecast { values, intervals, facts: facts(view, subject, selector, prepared.moments()) }
}

/// Blocks of times.
fn blocks(times: usize) -> Vec<Range<usize>> {
    (0..times).step_by(TIMES_PER_BLOCK).map(|start| start..times.min(start + TIMES_PER_BLOCK)).collect()
}

fn facts(view: &MapView, subject: &StateOrCell, selector: ModelSelector, moments: &[Moment]) -> StateFacts {
    let mut last_nanos = subject.persistence(view).last().map(|(nanos, _)| nanos);
    if subject.reporting(view).may_end() {
        // The time of a value that holds is never newer than the requested times, so that its age is never below 0.
        last_nanos = last_nanos.min(moments.iter().map(|moment| moment.utc_nanos).max());
    }
    StateFacts {
        kind: subject.kind(view),
        order: subject.order(view, selector),
        observations: subject.observations(view),
        pending: subject.pending(view),
        answered_by: subject.answered_by(view, selector),
        last_nanos,
    }
}

/// The angle whose cosine and sine these are: the direction of both. Its interval extends equally to both sides, by the
/// deviation that follows from the half-widths of the two intervals, and may end beyond -π or π.
fn angle(cosine: StateForecast, sine: StateForecast) -> StateForecast {
    let StateForecast { values: cosines, intervals: about_cosines, facts } = cosine;
    let StateForecast { values: sines, intervals: about_sines, facts: StateFacts { order, .. } } = sine;
    let pairs = || cosines.iter().zip(&sines).map(|(cos, sin)| [*cos, *sin]);
    let half = |held: &HeldInterval| held.interval.width() / 2.0;
    let interval = |(parts, (cos, sin)): ([f64; 2], (&HeldInterval, &HeldInterval))| {
        let (middle, reach) = (direction_rad(parts), deviation_of_direction_rad(parts, [half(cos), half(sin)]));
        HeldInterval {
            interval: Interval { lower: middle - reach, upper: middle + reach },
            mass: cos.mass.min(sin.mass),
        }
    };
    let intervals = pairs().zip(about_cosines.iter().zip(&about_sines)).map(interval).collect();
    let values = pairs().map(direction_rad).collect();
    let facts = StateFacts { order: facts.order.max(order), ..facts };
    StateForecast { values, intervals, facts }
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
