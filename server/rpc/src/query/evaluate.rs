//! `EvaluateStates`: compares predictions with observations, which are not learned.
//!
//! Observations wait until there are many of them; then they are compared state by state, so that only the models of
//! one state at a time are held, however many states there are.
//!
//! Invariant: memory depends on the number of states and models, not on that of observations; the models of only one
//! state at a time are held.

use std::{borrow::Cow, collections::HashMap, sync::Arc};

use tidemap_answer::{AnswerSource, Compared, Evaluator, ModelUnavailable, OtherPart, StateOrCell};
use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    event::{StateKind, StateShape},
    history::Subject,
    ids::StateId,
    view::MapView,
};
use tidemap_model::{LearnedRows, RowReadings, Sample, StopSignal};
use tidemap_proto::{
    convert::{
        columns::DecodedColumns,
        query::{
            EvaluatedModel, evaluated_from_wire, evaluated_model_to_wire, evaluation_from_wire, header_of,
            unavailable_model_to_wire, unpack_evaluated,
        },
    },
    v1,
};
use tonic::{Status, Streaming};

use super::{Queries, STATES_MAX};
use crate::{
    lookup::{check_limit, find_all, find_map},
    permits::run_while_awaited,
    status::{Misfit, Problem, RpcError},
    training::LearnedState,
};

/// Maximum number of error sums of one evaluation, one per state, model and order: 24 MB, which fits into a reply.
const SUMS_MAX: usize = 1_000_000;
/// Maximum number of observations that wait to be compared, 12 MB: with fewer, models that the cache does not keep are
/// trained more often.
const WAITING_MAX: usize = 500_000;
/// Maximum number of readings that rows of changes and events may represent in one evaluation: a hundred sensors for
/// nine years at steps of five minutes.
const READINGS_MAX: u64 = 100_000_000;
/// Number of readings of rows that are made and compared at once.
const READINGS_PER_BLOCK: usize = 65_536;

pub(super) async fn evaluate_states(
    queries: &Queries,
    mut stream: Streaming<v1::EvaluateStatesRequest>,
) -> Result<v1::EvaluateStatesResponse, Status> {
    let header = header_of(stream.message().await?).map_err(RpcError::from)?;
    let handle = find_map(&queries.catalog, &header.map).await?;
    let question = evaluation_from_wire(header).map_err(RpcError::from)?;
    check_limit("models", question.models.len() as u64, 64, "one request")?;
    let view = handle.view();
    let mut evaluator = Evaluator::new(Arc::clone(&view), question.models, question.max_order);
    let mut table: Vec<TableEntry> = Vec::new();
    let mut waiting = WaitingObservations::default();
    let mut held = HeldRows::default();
    while let Some(request) = stream.message().await? {
        let mut packed = evaluated_from_wire(request).map_err(RpcError::from)?;
        extend_table(&mut table, packed.take_named_kinds(), &view, &evaluator).await?;
        let (got, max) = (packed.observations() as u64, queries.max_batch as u64);
        check_limit("observations of one message", got, max, "setting max_batch_observations")?;
        let columns = unpack_evaluated(packed, table.len()).map_err(RpcError::from)?;
        take_observations(&columns, &table, &view, &mut evaluator, &mut waiting).map_err(RpcError::from)?;
        // Without models to train, nothing is gained by waiting.
        if waiting.count >= WAITING_MAX || evaluator.kinds_to_train().next().is_none() {
            let taken = held.take(std::mem::take(&mut waiting), &view, false);
            (evaluator, held.readings) = compare(queries, &handle, &view, taken, (evaluator, held.readings)).await?;
        }
    }
    let taken = held.take(waiting, &view, true);
    let (evaluator, _) = compare(queries, &handle, &view, taken, (evaluator, held.readings)).await?;
    Ok(answer(&evaluator, &view))
}

/// Adds names to the table of a stream.
async fn extend_table(
    table: &mut Vec<TableEntry>,
    names: Vec<(String, bool)>,
    view: &Arc<MapView>,
    evaluator: &Evaluator,
) -> Result<(), RpcError> {
    check_limit("states", (table.len() + names.len()) as u64, STATES_MAX as u64, "one evaluation")?;
    for (name, is_label) in names {
        let states = table.len() + 1;
        let sums = states.saturating_mul(evaluator.sums_per_state()) as u64;
        check_limit("states times models and orders", sums, SUMS_MAX as u64, "one evaluation")?;
        table.push(TableEntry::find(view, (name, is_label), table).await?);
    }
    Ok(())
}

/// Adds the observations of a message to those that wait.
fn take_observations(
    columns: &DecodedColumns,
    table: &[TableEntry],
    view: &MapView,
    evaluator: &mut Evaluator,
    waiting: &mut WaitingObservations,
) -> Result<(), Misfit> {
    let mut make = view.sample_maker();
    let rows = columns.state_indices.iter().zip(&columns.times_nanos).zip(&columns.values);
    for ((&index, &time), &value) in rows {
        // Every index is an index of the table.
        let Some(entry) = table.get(index as usize) else { continue };
        let shape = entry.shape(view);
        let is_allowed = match entry.compared {
            Compared::Alone => shape.kind().bounds().contains(&value),
            Compared::Angle => shape.allows(value),
            Compared::Labels => value == 1.0,
        };
        let is_allowed = is_allowed || (value.is_nan() && entry.state.reporting(view).may_end());
        if !is_allowed {
            return Err(Problem::Value { value, shape }.of("observations.values"));
        }
        evaluator.begin(&entry.state, entry.compared);
        let value = if entry.compared == Compared::Labels { f64::from(entry.label) } else { value };
        waiting.push(entry, make(time, value));
    }
    Ok(())
}

/// The reply: a row per state and model, and the models that some states do not have.
fn answer(evaluator: &Evaluator, view: &MapView) -> v1::EvaluateStatesResponse {
    let evaluations = evaluator.rows().map(|(state, name, model, errors)| {
        evaluated_model_to_wire(EvaluatedModel {
            state: name.into_owned(),
            model,
            errors,
            is_probability: state.kind(view) == StateKind::Probability,
            has_labels: evaluator.has_labels(&state),
        })
    });
    let unavailable = evaluator.unavailable().into_iter().map(|(model, reason, states)| {
        unavailable_model_to_wire(model, reason, states.into_iter().map(Cow::into_owned).collect())
    });
    v1::EvaluateStatesResponse { evaluations: evaluations.collect(), unavailable: unavailable.collect() }
}

/// Observations that are not compared yet, by state in the order of first appearance.
#[derive(Debug, Default)]
struct WaitingObservations {
    by_state: HashMap<Subject, Vec<Sample>>,
    entries: Vec<TableEntry>,
    count: usize,
}

impl WaitingObservations {
    fn push(&mut self, entry: &TableEntry, sample: Sample) {
        let entries = &mut self.entries;
        let samples = self.by_state.entry(entry.state.subject()).or_insert_with(|| {
            entries.push(entry.clone());
            Vec::new()
        });
        samples.push(sample);
        self.count += 1;
    }
}

/// The learned data of the states that report changes or events, from the observations so far.
#[derive(Debug, Default)]
struct HeldRows {
    learned: HashMap<Subject, (TableEntry, LearnedRows)>,
    newest_nanos: i64,
    /// Number of readings so far.
    readings: u64,
}

/// The readings of a state that are to be compared.
#[derive(Debug)]
enum TakenReadings {
    Samples(Vec<Sample>),
    /// The readings that rows represent, which may be far more than the rows.
    Rows(RowReadings),
}

impl HeldRows {
    /// Takes the readings that observations represent, for each state up to its own newest row: more of its rows may
    /// come. With the last observations, it takes them up to the newest row of all states.
    fn take(
        &mut self,
        waiting: WaitingObservations,
        view: &MapView,
        are_last: bool,
    ) -> Vec<(TableEntry, TakenReadings)> {
        let WaitingObservations { mut by_state, mut entries, .. } = waiting;
        let newest = by_state.values().flatten().map(|sample| sample.utc_nanos).max();
        self.newest_nanos = self.newest_nanos.max(newest.unwrap_or(0));
        for entry in entries.iter().filter(|entry| entry.state.reporting(view).may_end()) {
            self.learned.entry(entry.state.subject()).or_insert_with(|| (entry.clone(), LearnedRows::default()));
        }
        if are_last {
            // A value that holds since rows of earlier messages continues.
            let without_rows = self.learned.iter().filter(|(subject, _)| !by_state.contains_key(subject));
            entries.extend(without_rows.map(|(_, (entry, _))| entry.clone()));
        }
        let horizon_nanos = if are_last { self.newest_nanos.saturating_add(1) } else { i64::MIN };
        let readings = |entry: TableEntry| {
            let mut samples = by_state.remove(&entry.state.subject()).unwrap_or_default();
            let Some((_, learned)) = self.learned.get_mut(&entry.state.subject()) else {
                return (entry, TakenReadings::Samples(samples));
            };
            samples.sort_by_key(|sample| sample.utc_nanos);
            let rows = samples.iter().map(Sample::row).collect();
            let (readings, after) = std::mem::take(learned).learn(entry.state.reporting(view), rows, horizon_nanos);
            *learned = after;
            (entry, TakenReadings::Rows(readings))
        };
        entries.into_iter().map(readings).collect()
    }
}

/// Compares observations, and holds the models of one state at a time. Takes and returns the sums and the number of
/// readings of rows.
async fn compare(
    queries: &Queries,
    handle: &Arc<MapHandle>,
    view: &Arc<MapView>,
    taken: Vec<(TableEntry, TakenReadings)>,
    (mut evaluator, mut readings): (Evaluator, u64),
) -> Result<(Evaluator, u64), Status> {
    let mut work: Vec<SubjectWork> = Vec::new();
    let last = taken.len().saturating_sub(1);
    for (index, (entry, taken)) in taken.into_iter().enumerate() {
        let subject = entry.state.subject();
        let others = entry.others(view);
        let mut trained = Vec::with_capacity(others.len() + 1);
        let axes = [entry.state].into_iter().chain(others.iter().copied().map(StateOrCell::from));
        let mut held = queries.trainer.reserve().map_err(RpcError::from)?;
        for axis in axes {
            let learned = LearnedState::new(Arc::clone(handle), Arc::clone(view), axis);
            let models = queries.trainer.all_trained(&learned, evaluator.kinds_to_train()).await?;
            held.grow(models.iter().flatten().count()).map_err(RpcError::from)?;
            let source = |model| match model {
                Ok(trained) => AnswerSource::Trained(trained),
                Err(reason) => evaluator.nothing(&ModelUnavailable::to_string(&reason)),
            };
            trained.push(models.into_iter().map(source).collect::<Vec<AnswerSource>>());
        }
        let needs_models = trained.iter().any(|sources| !sources.is_empty());
        let mut trained = trained.into_iter();
        let own = trained.next().unwrap_or_default();
        let others =
            others.into_iter().map(|state| OtherPart { state, trained: trained.next().unwrap_or_default() }).collect();
        work.push(SubjectWork { subject, taken, own, others });
        // States that the view predicts by itself hold no models: they are compared together.
        if needs_models || index == last {
            let (work, view) = (std::mem::take(&mut work), Arc::clone(view));
            let add = move |stop: StopSignal<'_>| {
                for work in work {
                    work.add_to(&mut evaluator, &view, &mut readings, stop)?;
                }
                Ok::<_, RpcError>((evaluator, readings))
            };
            (evaluator, readings) = run_while_awaited((), None, add).await??;
        }
        drop(held);
    }
    Ok((evaluator, readings))
}

/// The observations of a state with the models that predict them.
#[derive(Debug)]
struct SubjectWork {
    subject: Subject,
    taken: TakenReadings,
    own: Vec<AnswerSource>,
    others: Vec<OtherPart>,
}

impl SubjectWork {
    /// Adds the observations to the sums, and the number of readings that rows represent to `readings`.
    fn add_to(
        self,
        evaluator: &mut Evaluator,
        view: &MapView,
        readings: &mut u64,
        stop: StopSignal<'_>,
    ) -> Result<(), RpcError> {
        let SubjectWork { subject, taken, own, others } = self;
        let mut rows = match taken {
            TakenReadings::Samples(samples) => return Ok(evaluator.add(subject, &samples, own, others, stop)?),
            TakenReadings::Rows(rows) => rows,
        };
        let mut make = view.sample_maker();
        loop {
            let block: Vec<Sample> =
                rows.by_ref().take(READINGS_PER_BLOCK).map(|(nanos, value)| make(nanos, value)).collect();
            *readings += block.len() as u64;
            check_limit("readings of rows", *readings, READINGS_MAX, "one evaluation")?;
            evaluator.add(subject, &block, own.clone(), others.clone(), stop)?;
            if block.len() < READINGS_PER_BLOCK {
                return Ok(());
            }
        }
    }
}

/// The state and its parts with which observations of a name are compared.
#[derive(Clone, Debug)]
struct TableEntry {
    /// The state or cell, the cosine of an angle, or the first label of a categorical state.
    state: StateOrCell,
    compared: Compared,
    /// The number of the label that is observed.
    label: u8,
}

impl TableEntry {
    /// Makes the entry of a name. `others` has the entries of the names before it.
    async fn find(
        view: &Arc<MapView>,
        (name, is_label): (String, bool),
        others: &[TableEntry],
    ) -> Result<TableEntry, RpcError> {
        let field = |_| "observations.new_states".to_owned();
        let entry = match view.shape(&name) {
            Some((state, StateShape::Angle)) => TableEntry { state: state.into(), compared: Compared::Angle, label: 0 },
            None if is_label && let Some(unknown) = unknown_label(view, &name) => return Err(unknown.into()),
            Some((held, _)) if is_label && let Some(first) = first_label(view, held) => {
                let label = u8::try_from(held.0 - first.0).unwrap_or(u8::MAX);
                TableEntry { state: first.into(), compared: Compared::Labels, label }
            }
            _ => {
                let found = find_all(view, field, vec![name.clone()]).await?.pop();
                TableEntry { state: found.ok_or(RpcError::Stopping)?, compared: Compared::Alone, label: 0 }
            }
        };
        let is_other =
            |other: &TableEntry| other.state.subject() == entry.state.subject() && other.compared != entry.compared;
        if others.iter().any(is_other) {
            return Err(Problem::AngleAndCosine { name }.of("observations.new_states").into());
        }
        Ok(entry)
    }

    fn shape(&self, view: &MapView) -> StateShape {
        match self.compared {
            Compared::Angle => StateShape::Angle,
            Compared::Labels => StateShape::Categorical(0),
            Compared::Alone => StateShape::Scalar(self.state.kind(view)),
        }
    }

    /// The parts after the first one: the sine of an angle, or labels.
    fn others(&self, view: &MapView) -> Vec<StateId> {
        let StateOrCell::State(first) = self.state else { return Vec::new() };
        let count = match self.compared {
            Compared::Alone => 1,
            Compared::Angle => 2,
            Compared::Labels => whole_of(view, first).map_or(1, |whole| view.labels(whole).len()),
        };
        (first.0..).skip(1).take(count - 1).map(StateId).collect()
    }
}

/// The name of the categorical state that has this label.
fn whole_of(view: &MapView, label: StateId) -> Option<&str> {
    Some(view.info(label)?.name.as_label()?.0)
}

/// The first label of the categorical state that has this label.
fn first_label(view: &MapView, label: StateId) -> Option<StateId> {
    view.labels(whole_of(view, label)?).first().map(|(first, _)| *first)
}

/// The error of a label that a categorical state does not have.
fn unknown_label(view: &MapView, name: &str) -> Option<Misfit> {
    let (state, label) = name.split_once('/')?;
    let labels: Vec<String> = view.labels(state).into_iter().map(|(_, label)| label.to_owned()).collect();
    let (state, label) = (state.to_owned(), label.chars().take(80).collect());
    (!labels.is_empty()).then(|| Problem::UnknownLabel { state, label, labels }.of("observations.new_states"))
}
