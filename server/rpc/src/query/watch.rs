//! `WatchAnomalies`: unexpected observations, as they arrive.
//!
//! The writer copies the observations that it applies into pieces, and sends them when the view that shows them is
//! published ([`tidemap_ingest::anomaly_feed`]). A watch judges them in its own task, by the models that were in force
//! when they were applied, however late the watch is. An observation that falls out of the feed, or is two updates
//! behind, is counted as missed, and a reader that reads nothing for five minutes is disconnected. An observation with
//! a time after the clock is judged at once, although it waits to be learned. Scans arrive as the bits of the tiles
//! that they changed, from which a watch follows its cells; where scans were missed, the watch begins again with the
//! present bits of the tiles.
//!
//! Invariant: a watcher never slows the writer, and a bounded number of observations wait for it. Judging has its own
//! permits, which leave processors free.

use std::{
    collections::{BTreeSet, HashSet},
    sync::Arc,
    time::Duration,
};

use tidemap_base::shares::{Share, Shares, client::Client};
use tidemap_grid::{
    follower::CellFollower,
    index::{CellBox, CellIndex},
};
use tidemap_ingest::{
    anomaly_feed::{CellFeed, FeedMessage, FeedPiece, FeedReceiver, FeedScans},
    handle::MapHandle,
    protocol::Command,
};
use tidemap_map::{
    anomaly::{Anomaly, Confidence},
    event::Reporting,
    history::Reading,
    ids::StateId,
    view::MapView,
};
use tidemap_model::selector::ModelSelector;
use tidemap_proto::{
    convert::{
        anomaly::{WatchQuestion, watch_from_wire, watched_to_wire},
        cells::cell_from_wire,
    },
    v1,
};
use tokio::sync::{Semaphore, broadcast::error::RecvError, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::{Queries, STATES_MAX};
use crate::{
    lookup::{check_limit, find_location, find_map, find_parts},
    permits::{processors, run_blocking},
    replies::Replies,
    status::RpcError,
};

/// Number of replies that wait for the reader.
const REPLIES_AHEAD: usize = 2;
/// Number of anomalies in one reply.
const ANOMALIES_PER_REPLY: usize = 1024;
/// A reply waits this long for its reader. The time is longer than elsewhere, because people watch, and pause.
const READ_WITHIN: Duration = Duration::from_secs(300);

type Sender = mpsc::Sender<Result<v1::WatchAnomaliesResponse, Status>>;

/// Limits of watches.
#[derive(Debug)]
pub(super) struct Watches {
    shares: Shares,
    permits: Arc<Semaphore>,
}

impl Watches {
    /// Creates the limits; watches take from these shares.
    pub(super) fn new(shares: Shares) -> Self {
        Self { shares, permits: Arc::new(Semaphore::new((processors() / 2).max(1))) }
    }
}

pub(super) async fn watch_anomalies(
    queries: &Queries,
    request: v1::WatchAnomaliesRequest,
) -> Result<Replies<v1::WatchAnomaliesResponse>, RpcError> {
    let handle = find_map(&queries.catalog, &request.map).await?;
    let question = watch_from_wire(request)?;
    check_limit("states", question.states.len() as u64, STATES_MAX as u64, "one request")?;
    let Selection { states, cells } = watched(&handle.view(), &question)?;
    let WatchQuestion { confidence, selector, .. } = question;
    let place = queries.watches.shares.take(Share::Watches, &Client::current(), 1)?;
    let listening = if states.as_ref().is_none_or(|states| !states.is_empty()) {
        let (reply, listening) = oneshot::channel();
        if !handle.send(Command::Watch(reply)) {
            return Err(RpcError::Stopping);
        }
        Some(listening.await.map_err(|_| RpcError::Stopping)?)
    } else {
        None
    };
    let scans = if cells.is_empty() { None } else { Some(CellsWatch::begin(&handle, cells).await?) };
    let sent = listening.as_ref().map_or(0, |(_, sent)| *sent);
    let listening = listening.map(|(listening, _)| listening);
    let permits = Arc::clone(&queries.watches.permits);
    let watch = Watch { handle, watched: states, scans, confidence, selector, permits, sent, missed: 0 };
    let (replies, stream) = mpsc::channel(REPLIES_AHEAD + 1);
    // The room is reserved now: when the reader is slow, there is no room for the last reply.
    let last_word = replies.clone().try_reserve_owned().map_err(|_| RpcError::Stopping)?;
    tidemap_base::task::spawn(async move {
        let _place = place;
        if let Err(end) = watch.run(listening, &replies).await {
            last_word.send(Err(end.into()));
        }
    });
    Ok(ReceiverStream::new(stream))
}

/// The states and cells that are watched.
struct Selection {
    /// `None`: all states, including future ones.
    states: Option<HashSet<StateId>>,
    cells: BTreeSet<CellIndex>,
}

fn watched(view: &MapView, question: &WatchQuestion) -> Result<Selection, RpcError> {
    let WatchQuestion { states: names, region, location, .. } = question;
    let (mut states, mut cells) = (HashSet::new(), BTreeSet::new());
    let map = || view.spec().name.as_str().to_owned();
    let grid = || view.grid().ok_or_else(|| RpcError::NoGrid { map: map() });
    for (i, name) in names.iter().enumerate() {
        match cell_from_wire(&format!("states[{i}]"), name)? {
            Some(cell) => {
                let (index, place) = cell.tile();
                let tile = grid()?.find(index).and_then(|tile| grid().ok()?.live(tile));
                if !tile.is_some_and(|tile| tile.known.contains(place)) {
                    return Err(RpcError::UnknownCell { map: map(), name: cell.name() });
                }
                cells.insert(cell);
            }
            None => states.extend(find_parts(view, name)?),
        }
    }
    if let Some(name) = location {
        let members = find_location(view, name)?;
        states.extend(&members.states);
        cells.extend(&members.cells);
    }
    if let Some(region) = region {
        grid()?;
        let count = u64::try_from(region.count()).unwrap_or(u64::MAX);
        check_limit("cells", count, STATES_MAX as u64, "one request")?;
        let CellBox { min, max } = *region;
        let row = |y: i32, z: i32| (min.x..max.x).map(move |x| CellIndex { x, y, z });
        cells.extend((min.z..max.z).flat_map(|z| (min.y..max.y).flat_map(move |y| row(y, z))));
    }
    check_limit("states and cells", (states.len() + cells.len()) as u64, STATES_MAX as u64, "one request")?;
    let is_all = names.is_empty() && region.is_none() && location.is_none();
    Ok(Selection { states: (!is_all).then_some(states), cells })
}

/// A reading of a state.
type StateReading = (StateId, Reading);

/// An anomaly of a state or a cell.
type Found = (AnomalySubject, Anomaly);

/// The state or cell of an anomaly.
#[derive(Clone, Copy)]
enum AnomalySubject {
    State(StateId),
    Cell(CellIndex),
}

/// The cells that are watched.
struct CellsWatch {
    cells: Arc<BTreeSet<CellIndex>>,
    /// `None` while it judges.
    follower: Option<CellFollower>,
    scans: FeedReceiver,
    /// Number of scans before the next event.
    sent: u64,
}

impl CellsWatch {
    async fn begin(handle: &MapHandle, cells: BTreeSet<CellIndex>) -> Result<CellsWatch, RpcError> {
        let cells = Arc::new(cells);
        let (follower, CellFeed { scans, sent, .. }) = follow(handle, &cells).await?;
        Ok(CellsWatch { cells, follower: Some(follower), scans, sent })
    }

    /// Begins again after scans were missed; returns the number of missed scans.
    async fn resume(&mut self, handle: &MapHandle) -> Result<u64, RpcError> {
        let (follower, CellFeed { scans, sent, .. }) = follow(handle, &self.cells).await?;
        let missed = sent.saturating_sub(self.sent);
        (self.follower, self.scans, self.sent) = (Some(follower), scans, sent);
        Ok(missed)
    }
}

/// Subscribes to scans, and follows cells from there on.
async fn follow(handle: &MapHandle, cells: &BTreeSet<CellIndex>) -> Result<(CellFollower, CellFeed), RpcError> {
    let (reply, listening) = oneshot::channel();
    if !handle.send(Command::WatchCells(reply)) {
        return Err(RpcError::Stopping);
    }
    let feed = listening.await.map_err(|_| RpcError::Stopping)?;
    let grid = feed.view.grid().ok_or(RpcError::Stopping)?;
    Ok((CellFollower::new(grid, cells.iter().copied()), feed))
}

/// The next message. Without a receiver, it never comes.
async fn next(receiver: Option<&mut FeedReceiver>) -> Result<Arc<FeedMessage>, RecvError> {
    match receiver {
        Some(receiver) => receiver.recv().await,
        None => std::future::pending().await,
    }
}

struct Watch {
    handle: Arc<MapHandle>,
    watched: Option<HashSet<StateId>>,
    scans: Option<CellsWatch>,
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
    async fn run(mut self, mut listening: Option<FeedReceiver>, replies: &Sender) -> Result<(), RpcError> {
        loop {
            let message = tokio::select! {
                () = replies.closed() => return Ok(()),
                message = next(listening.as_mut()) => message,
                message = next(self.scans.as_mut().map(|cells| &mut cells.scans)) => match message {
                    Err(RecvError::Lagged(_)) => {
                        if let Some(cells) = &mut self.scans {
                            self.missed += cells.resume(&self.handle).await?;
                        }
                        continue;
                    }
                    message => message,
                },
            };
            let found = match message {
                Ok(message) => match &*message {
                    FeedMessage::Applied(applied) => self.judge(applied).await?,
                    FeedMessage::Scanned(_) => self.judge_cells(message).await?,
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

    /// The anomalies among the readings of the watched cells in applied scans, scan by scan.
    async fn judge_cells(&mut self, message: Arc<FeedMessage>) -> Result<Vec<Found>, RpcError> {
        let (Some(cells), FeedMessage::Scanned(FeedScans { models, before, event })) = (&mut self.scans, &*message)
        else {
            return Ok(Vec::new());
        };
        self.missed += before.saturating_sub(cells.sent);
        cells.sent = before + event.scans.len() as u64;
        let Some(mut follower) = cells.follower.take() else { return Ok(Vec::new()) };
        let Some(models) = models.upgrade() else {
            follower.pass(event, |_, _| ());
            cells.follower = Some(follower);
            self.missed += event.scans.len() as u64;
            return Ok(Vec::new());
        };
        let permit = Arc::clone(&self.permits).acquire_owned().await.map_err(|_| RpcError::Stopping)?;
        let (confidence, selector) = (self.confidence, self.selector);
        let message = Arc::clone(&message);
        let judge = move || {
            let FeedMessage::Scanned(scans) = &*message else { return (Ok(Vec::new()), follower) };
            let found = models.unexpected_cells(&mut follower, &scans.event, selector, confidence);
            (found, follower)
        };
        let (found, follower) = run_blocking(permit, judge).await?;
        cells.follower = Some(follower);
        Ok(found?.into_iter().map(|(cell, anomaly)| (AnomalySubject::Cell(cell), anomaly)).collect())
    }

    /// The anomalies among applied observations, in their order.
    async fn judge(&mut self, applied: &FeedPiece) -> Result<Vec<Found>, RpcError> {
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
        let found = run_blocking(permit, move || unexpected(&models, &observed, selector, confidence)).await?;
        Ok(found.into_iter().map(|(state, anomaly)| (AnomalySubject::State(state), anomaly)).collect())
    }

    /// The observations of the watched states.
    fn observed(&self, applied: &FeedPiece) -> Vec<StateReading> {
        let is_watched = |state: &StateId| self.watched.as_ref().is_none_or(|watched| watched.contains(state));
        let readings = applied.times_nanos.iter().copied().zip(applied.values.iter().copied());
        applied.states.iter().copied().zip(readings).filter(|(state, _)| is_watched(state)).collect()
    }

    /// Sends anomalies, and the number of missed observations. Returns `false` if the client is gone.
    async fn reply(&mut self, found: &[Found], replies: &Sender) -> Result<bool, RpcError> {
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

    fn reply_of(&self, found: &[Found], missed_observations: u64) -> v1::WatchAnomaliesResponse {
        let view = self.handle.view();
        let name = |subject| match subject {
            AnomalySubject::State(id) => view.info(id).map_or_else(String::new, |info| info.name.as_str().to_owned()),
            AnomalySubject::Cell(cell) => cell.name(),
        };
        watched_to_wire(found.iter().map(|&(subject, anomaly)| (name(subject), anomaly)), missed_observations)
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
    // The sort is stable, so that the observations of a state keep their order.
    by_state.sort_by_key(|&i| observed[i].0);
    let mut found = Vec::new();
    for places in by_state.chunk_by(|&a, &b| observed[a].0 == observed[b].0) {
        let state = observed[places[0]].0;
        let reporting = models.info(state).map_or(Reporting::Samples, |info| info.reporting);
        if matches!(reporting, Reporting::Events(_)) {
            // A single event is not a number of events in a step.
            continue;
        }
        // A row that states that the value is unknown is no reading.
        let places: Vec<usize> = places.iter().copied().filter(|&i| !observed[i].1.1.is_nan()).collect();
        let readings: Vec<Reading> = places.iter().map(|&i| observed[i].1).collect();
        let times: Vec<i64> = readings.iter().map(|(nanos, _)| *nanos).collect();
        let mut expected = vec![0.0; times.len()];
        models.predict_into(state, &models.prepare(&times), selector.long_term(), &mut expected);
        let judged = models.judged(state, selector, &readings, &expected, confidence);
        found.extend(places.iter().zip(judged).filter_map(|(&place, anomaly)| Some((place, state, anomaly?))));
    }
    found.sort_by_key(|(place, ..)| *place);
    found.into_iter().map(|(_, state, anomaly)| (state, anomaly)).collect()
}
