//! `WatchAnomalies`: unexpected observations, as they arrive.
//!
//! The writer copies what it applies into pieces, and sends them when the view that shows them is published
//! ([`crate::ingest::anomaly_feed`]). A watch judges them in its own task, by the models that were in force when they
//! were applied, however late it is. What falls out of the feed, or is two updates behind, is counted as missed, and a
//! reader that reads nothing for five minutes is disconnected. An observation ahead of the clock is judged at once,
//! although it waits to be learned. Cells cannot be watched: a scan is logged as the bits of tiles that it changed,
//! which become readings of cells only in an update.
//!
//! Invariant: a watcher never slows the writer, and a bounded number of observations wait for it. Judging has its own
//! permits, which leave processors free.

use std::{collections::HashSet, sync::Arc, time::Duration};

use tidemap_map::{
    anomaly::{Anomaly, Confidence},
    grid::index::CellIndex,
    history::Reading,
    ids::StateId,
    selector::ModelSelector,
    view::MapView,
};
use tidemap_proto::{
    convert::{
        InvalidField, OverLimit,
        anomaly::{confidence_from_wire, watching_judge_from_wire},
    },
    v1,
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, broadcast::error::RecvError, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::{Queries, STATES_MAX};
use crate::{
    ingest::{
        anomaly_feed::{FeedMessage, FeedPiece, FeedReceiver},
        handle::MapHandle,
        protocol::Command,
    },
    rpc::{
        lookup::{check_limit, find_map, find_state},
        permits::{processors, run_blocking},
        replies::Replies,
        status::RpcError,
    },
};

/// Replies that wait for the reader.
const REPLIES_AHEAD: usize = 2;
/// Anomalies of one reply.
const ANOMALIES_PER_REPLY: usize = 1024;
/// A reply waits this long for its reader. Longer than elsewhere, because people watch, and pause.
const READ_WITHIN: Duration = Duration::from_secs(300);

type Sender = mpsc::Sender<Result<v1::WatchAnomaliesResponse, Status>>;

/// Limits of watches.
#[derive(Debug)]
pub(super) struct Watches {
    places: Arc<Semaphore>,
    max: usize,
    permits: Arc<Semaphore>,
}

impl Watches {
    /// At most `max` at once.
    pub(super) fn new(max: usize) -> Self {
        let max = max.min(Semaphore::MAX_PERMITS);
        let permits = Arc::new(Semaphore::new((processors() / 2).max(1)));
        Self { places: Arc::new(Semaphore::new(max)), max, permits }
    }

    fn place(&self) -> Result<OwnedSemaphorePermit, RpcError> {
        let max = self.max as u64;
        let full = |_| OverLimit { what: "watches", got: Some(max + 1), max, setting: "setting max_watches" }.into();
        Arc::clone(&self.places).try_acquire_owned().map_err(full)
    }
}

pub(super) async fn watch_anomalies(
    queries: &Queries,
    request: v1::WatchAnomaliesRequest,
) -> Result<Replies<v1::WatchAnomaliesResponse>, RpcError> {
    let v1::WatchAnomaliesRequest { map, states, confidence, model } = request;
    let handle = find_map(&queries.catalog, &map).await?;
    let confidence = confidence_from_wire("confidence", confidence)?;
    let selector = watching_judge_from_wire("model", model)?;
    check_limit("states", states.len() as u64, STATES_MAX as u64, "one request")?;
    let watched = watched(&handle.view(), &states)?;
    let place = queries.watches.place()?;
    let (reply, listening) = oneshot::channel();
    if !handle.send(Command::Watch(reply)) {
        return Err(RpcError::Stopping);
    }
    let (listening, sent) = listening.await.map_err(|_| RpcError::Stopping)?;
    let permits = Arc::clone(&queries.watches.permits);
    let watch = Watch { handle, watched, confidence, selector, permits, sent, missed: 0 };
    let (replies, stream) = mpsc::channel(REPLIES_AHEAD + 1);
    // Reserved now: when the reader is slow, there is no room for the last reply.
    let last_word = replies.clone().try_reserve_owned().map_err(|_| RpcError::Stopping)?;
    tokio::spawn(async move {
        let _place = place;
        if let Err(end) = watch.run(listening, &replies).await {
            last_word.send(Err(end.into()));
        }
    });
    Ok(ReceiverStream::new(stream))
}

/// The watched states; `None`: all, including future ones.
fn watched(view: &MapView, names: &[String]) -> Result<Option<HashSet<StateId>>, RpcError> {
    let find = |(i, name): (usize, &String)| match CellIndex::from_name(name) {
        Some(_) => {
            let text = format!("{name} is a cell, and cells are not watched: use FindAnomalies");
            Err(InvalidField::new(format!("states[{i}]"), text).into())
        }
        None => find_state(view, name),
    };
    let states = names.iter().enumerate().map(find).collect::<Result<HashSet<_>, RpcError>>()?;
    Ok((!states.is_empty()).then_some(states))
}

/// A reading of a state.
type StateReading = (StateId, Reading);

struct Watch {
    handle: Arc<MapHandle>,
    watched: Option<HashSet<StateId>>,
    confidence: Confidence,
    selector: ModelSelector,
    permits: Arc<Semaphore>,
    /// Number of observations before the next piece.
    sent: u64,
    /// Observations that were not judged since the last reply.
    missed: u64,
}

impl Watch {
    /// Sends anomalies until the client leaves, which is no error, or the map stops.
    async fn run(mut self, mut listening: FeedReceiver, replies: &Sender) -> Result<(), RpcError> {
        loop {
            let message = tokio::select! {
                () = replies.closed() => return Ok(()),
                message = listening.recv() => message,
            };
            let found = match message {
                Ok(message) => match &*message {
                    FeedMessage::Applied(applied) => self.judge(applied).await?,
                    FeedMessage::End(ending) => return Err(RpcError::Ended(ending.clone())),
                },
                // The next piece has the number of missed observations.
                Err(RecvError::Lagged(_)) => continue,
                Err(RecvError::Closed) => return Err(RpcError::Stopping),
            };
            if !self.reply(&found, replies).await? {
                return Ok(());
            }
        }
    }

    /// The anomalies among applied observations, in their order.
    async fn judge(&mut self, applied: &FeedPiece) -> Result<Vec<(StateId, Anomaly)>, RpcError> {
        let count = applied.states.len() as u64;
        self.missed += applied.before.saturating_sub(self.sent);
        self.sent = applied.before + count;
        let observed = self.observed(applied);
        if observed.is_empty() {
            return Ok(Vec::new());
        }
        let Some(models) = applied.models.upgrade() else {
            self.missed += count;
            return Ok(Vec::new());
        };
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(|_| RpcError::Stopping)?;
        let (confidence, selector) = (self.confidence, self.selector);
        run_blocking(permit, move || unexpected(&models, &observed, selector, confidence)).await
    }

    /// The observations of the watched states.
    fn observed(&self, applied: &FeedPiece) -> Vec<StateReading> {
        let is_watched = |state: &StateId| self.watched.as_ref().is_none_or(|watched| watched.contains(state));
        let readings = applied.times_nanos.iter().copied().zip(applied.values.iter().copied());
        applied.states.iter().copied().zip(readings).filter(|(state, _)| is_watched(state)).collect()
    }

    /// Sends anomalies, and the number of missed observations. `false`: the client is gone.
    async fn reply(&mut self, found: &[(StateId, Anomaly)], replies: &Sender) -> Result<bool, RpcError> {
        let mut pieces: Vec<_> = found.chunks(ANOMALIES_PER_REPLY).collect();
        if pieces.is_empty() && self.missed > 0 {
            pieces.push(&[]);
        }
        for piece in pieces {
            let missed_observations = std::mem::take(&mut self.missed);
            let reply = self.reply_of(piece, missed_observations);
            match tokio::time::timeout(READ_WITHIN, replies.send(Ok(reply))).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return Ok(false),
                Err(_) => return Err(RpcError::SlowReader(READ_WITHIN.as_secs())),
            }
        }
        Ok(true)
    }

    fn reply_of(&self, found: &[(StateId, Anomaly)], missed_observations: u64) -> v1::WatchAnomaliesResponse {
        let view = self.handle.view();
        let mut reply = v1::WatchAnomaliesResponse { missed_observations, ..Default::default() };
        for &(state, Anomaly { utc_nanos, value, probability }) in found {
            reply.states.push(view.info(state).map_or_else(String::new, |info| info.name.as_str().to_owned()));
            reply.times_nanos.push(utc_nanos);
            reply.values.push(value);
            reply.probabilities.push(probability);
        }
        reply
    }
}

/// The anomalies among observations of several states, in their order. The observations of a state are judged together.
fn unexpected(
    models: &MapView,
    observed: &[StateReading],
    selector: ModelSelector,
    confidence: Confidence,
) -> Vec<(StateId, Anomaly)> {
    let mut by_state: Vec<usize> = (0..observed.len()).collect();
    // Stable, so that the observations of a state keep their order.
    by_state.sort_by_key(|&i| observed[i].0);
    let mut found = Vec::new();
    for places in by_state.chunk_by(|&a, &b| observed[a].0 == observed[b].0) {
        let state = observed[places[0]].0;
        let readings: Vec<Reading> = places.iter().map(|&i| observed[i].1).collect();
        let times: Vec<i64> = readings.iter().map(|(nanos, _)| *nanos).collect();
        let mut expected = vec![0.0; times.len()];
        models.predict_into(state, &models.prepare(&times), selector, &mut expected);
        let judged = models.judged(state, selector, &readings, &expected, confidence);
        found.extend(places.iter().zip(judged).filter_map(|(&place, anomaly)| Some((place, state, anomaly?))));
    }
    found.sort_by_key(|(place, ..)| *place);
    found.into_iter().map(|(_, state, anomaly)| (state, anomaly)).collect()
}
