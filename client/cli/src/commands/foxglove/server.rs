//! The server: channels of the map, and the time bar of the clients.
//!
//! All clients share one time bar, as the protocol has one playback state for a server.
//!
//! Invariant: only data to which a client has subscribed is requested from the daemon. A request of the time bar is
//! answered at once, and the map of its time follows. A map is requested after the previous one has arrived, so clients
//! that move the bar quickly get the newest time only.

use std::{
    collections::HashMap,
    process::ExitCode,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
    websocket::{
        Capability, ChannelView, Client, PlaybackCommand, PlaybackControlRequest, PlaybackState, PlaybackStatus,
        ServerListener, Status,
    },
};
use tidemap_client::{
    clock,
    queries::{KEPT_CONFIDENCE, SurpriseQuery},
};
use tidemap_formats::{
    map_recording::{
        ANOMALIES_TOPIC, GRID_TOPIC, STATES_PREFIX, TOPOLOGY_TOPIC,
        messages::{self, AnomalyEntry},
    },
    table::Cell,
};
use tokio::{
    sync::Notify,
    time::{MissedTickBehavior, interval},
};

use super::{super::export::frames, Served, Session, playback::Playback};
use crate::progress::status_line;

/// Between two maps while the bar moves.
const TICK: Duration = Duration::from_millis(250);
/// An unusual observation is shown for this long.
const UNUSUAL_NANOS: i64 = 3_600_000_000_000;
/// Maximum number of unusual observations of a time.
const UNUSUAL_MAX: u32 = 100;
/// Messages that wait for a client before its oldest are dropped: a map and all of its states.
const BACKLOG: usize = 4_096;

/// The time bar, and who waits for its changes.
struct TimeBar {
    playback: Mutex<Playback>,
    changed: Notify,
}

impl TimeBar {
    fn playback(&self) -> MutexGuard<'_, Playback> {
        // A time bar is whole after every change.
        self.playback.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn state(playback: &Playback, did_seek: bool) -> PlaybackState {
    let status = match (playback.is_playing(), playback.is_at_end()) {
        (true, _) => PlaybackStatus::Playing,
        (false, true) => PlaybackStatus::Ended,
        (false, false) => PlaybackStatus::Paused,
    };
    PlaybackState {
        status,
        current_time: unsigned(playback.at_nanos()),
        playback_speed: playback.speed() as f32,
        did_seek,
        request_id: None,
    }
}

/// Times of the bar are in 1970 or later.
fn unsigned(nanos: i64) -> u64 {
    u64::try_from(nanos).unwrap_or_default()
}

impl ServerListener for TimeBar {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        self.changed.notify_one();
    }

    fn on_playback_control_request(&self, request: PlaybackControlRequest) -> Option<PlaybackState> {
        let seek = request.seek_time.map(|nanos| i64::try_from(nanos).unwrap_or(i64::MAX));
        let mut playback = self.playback();
        playback.request(request.playback_command == PlaybackCommand::Play, request.playback_speed.into(), seek);
        self.changed.notify_one();
        Some(state(&playback, seek.is_some()))
    }
}

/// The channels of a map.
struct Channels {
    context: Arc<Context>,
    grid: Option<Arc<RawChannel>>,
    topology: Option<Arc<RawChannel>>,
    anomalies: Arc<RawChannel>,
    /// By the names of states, of axes and of labels.
    states: HashMap<String, Arc<RawChannel>>,
}

impl Channels {
    /// The channels of the contents that the map has.
    async fn open(session: &Session, served: &Served) -> anyhow::Result<Self> {
        let context = Context::new();
        let map = session.client.map(&served.options.map).await?;
        let has_grid = map.grid_summary.is_some_and(|summary| summary.region.is_some());
        let has_topology = session.client.topology(&served.options.map).await?.nodes().len() > 0;
        let open = |topic: &str, name: &str, schema: &'static str| channel(&context, topic, name, schema);
        let grid = has_grid.then(|| open(GRID_TOPIC, "foxglove.Grid", messages::GRID_SCHEMA)).transpose()?;
        let topology = has_topology.then(|| open(TOPOLOGY_TOPIC, "foxglove.GeoJSON", messages::GEOJSON_SCHEMA));
        let topology = topology.transpose()?;
        let anomalies = open(ANOMALIES_TOPIC, "tidemap.Anomalies", messages::ANOMALIES_SCHEMA)?;
        let mut channels = Self { context, grid, topology, anomalies, states: HashMap::new() };
        let now = clock::now_nanos();
        for (name, _) in frames::states(session, &served.options, now, &served.states).await? {
            channels.open_state(name)?;
        }
        Ok(channels)
    }

    fn open_state(&mut self, name: String) -> anyhow::Result<Arc<RawChannel>> {
        if let Some(known) = self.states.get(&name) {
            return Ok(Arc::clone(known));
        }
        let topic = format!("{STATES_PREFIX}{name}");
        let new = channel(&self.context, &topic, "tidemap.State", messages::STATE_SCHEMA)?;
        self.states.insert(name, Arc::clone(&new));
        Ok(new)
    }

    /// Sends the map at a time to the clients that have subscribed to it.
    async fn put(&mut self, session: &Session, served: &Served, time_nanos: i64) -> anyhow::Result<()> {
        let Served { options, states, frame, .. } = served;
        let at = PartialMetadata::with_log_time(unsigned(time_nanos));
        if let Some(channel) = self.grid.as_ref().filter(|channel| channel.has_sinks()) {
            let grid = frames::grid(session, options, time_nanos).await?;
            channel.log_with_meta(&messages::grid(time_nanos, &grid.frame, &grid.picture)?, at);
        }
        if let Some(channel) = self.topology.as_ref().filter(|channel| channel.has_sinks())
            && let Some(graph) = frames::topology(session, options, time_nanos, frame).await?
        {
            channel.log_with_meta(&messages::topology(&graph.text)?, at);
        }
        if self.states.values().any(|channel| channel.has_sinks()) {
            for (name, value) in frames::states(session, options, time_nanos, states).await? {
                self.open_state(name)?.log_with_meta(&messages::state(time_nanos, value)?, at);
            }
        }
        if self.anomalies.has_sinks() {
            let query = SurpriseQuery {
                states: states.clone(),
                from_nanos: time_nanos.saturating_sub(UNUSUAL_NANOS).max(0),
                to_nanos: time_nanos.saturating_add(1),
                confidence: KEPT_CONFIDENCE,
                top: UNUSUAL_MAX,
            };
            let found = session.client.surprises(&options.map, query).await?;
            let entry = |(state, run): (String, tidemap_client::queries::SurpriseRun)| AnomalyEntry {
                state,
                first_nanos: run.first_nanos,
                last_nanos: run.last_nanos,
                value: run.value,
                probability: run.probability,
                bits: run.bits,
            };
            let entries: Vec<AnomalyEntry> = found.runs.into_iter().map(entry).collect();
            self.anomalies.log_with_meta(&messages::anomalies(time_nanos, &entries)?, at);
        }
        Ok(())
    }
}

fn channel(context: &Arc<Context>, topic: &str, name: &str, schema: &'static str) -> anyhow::Result<Arc<RawChannel>> {
    let schema = Schema::new(name, "jsonschema", schema.as_bytes());
    Ok(ChannelBuilder::new(topic).context(context).message_encoding("json").schema(schema).build_raw()?)
}

/// Serves a map until the program is ended.
pub(super) async fn run(session: &Session, served: Served) -> anyhow::Result<ExitCode> {
    let mut channels = Channels::open(session, &served).await?;
    let (first, last) = served.range_nanos;
    let playback = Playback::new(served.range_nanos, clock::now_nanos());
    let time_bar = Arc::new(TimeBar { playback: Mutex::new(playback), changed: Notify::new() });
    let (address, port) = served.address;
    let server = WebSocketServer::new()
        .name(format!("tidemap {}", served.options.map))
        .bind(address.to_string(), port)
        .capabilities([Capability::Time])
        .playback_time_range(unsigned(first), unsigned(last))
        .message_backlog_size(BACKLOG)
        .listener(Arc::clone(&time_bar) as Arc<dyn ServerListener>)
        .context(&channels.context)
        .start()
        .await?;
    let host = if address.is_ipv6() { format!("[{address}]") } else { address.to_string() };
    let url = format!("ws://{host}:{}", server.port());
    session.print(&["url", "from", "to"], [vec![Cell::Text(url), Cell::Time(first), Cell::Time(last)]])?;
    status_line("open this address in Foxglove: Open connection, Foxglove WebSocket; end with Ctrl-C");
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut last_check = Instant::now();
    let mut problem = None;
    loop {
        let is_requested = tokio::select! {
            () = time_bar.changed.notified() => true,
            _ = ticks.tick() => false,
        };
        let (was_playing, ended, at_nanos) = {
            let mut playback = time_bar.playback();
            let was_playing = playback.is_playing();
            let ended = playback.advance(last_check.elapsed()).then_some(*playback);
            last_check = Instant::now();
            (was_playing, ended, playback.at_nanos())
        };
        if !is_requested && !was_playing {
            continue;
        }
        server.broadcast_time(unsigned(at_nanos));
        let sent = channels.put(session, &served, at_nanos).await.map_err(|error| format!("{error:#}"));
        report_once(&server, sent.err(), &mut problem);
        // The end is reported after its map, unless a client has moved the bar meanwhile.
        if let Some(ended) = ended.filter(|ended| *ended == *time_bar.playback()) {
            server.broadcast_playback_state(state(&ended, false));
        }
    }
}

/// Reports a problem once; clients see it in Foxglove.
fn report_once(server: &WebSocketServerHandle, found: Option<String>, known: &mut Option<String>) {
    if found == *known {
        return;
    }
    match &found {
        Some(text) => {
            status_line(text);
            server.publish_status(Status::error(text.clone()).with_id("tidemap"));
        }
        None => server.remove_status(vec!["tidemap".to_owned()]),
    }
    *known = found;
}
