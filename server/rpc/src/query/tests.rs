//! Requests to a daemon's maps and their replies, on a real store.

use std::path::Path;

use tidemap_base::clock::SystemClock;
use tidemap_base::{
    config::Settings,
    shares::{ShareLimits, Shares},
};
use tidemap_grid::{
    index::TileIndex,
    mask::{Mask, TileMasks},
    spec::{GridSpec, Retention},
};
use tidemap_ingest::{
    handle::MapHandle,
    intake::{Intake, IntakeLimits},
    jobs::Jobs,
    protocol::{Command, Hello, ObservationBatch, SessionEvent, StreamData, Welcome},
    writer::Context,
};
use tidemap_map::{
    event::{SequenceSpan, UpdateCause},
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_model::{EnabledModels, Zone};
use tidemap_proto::{
    convert::{
        scans::{ScanLimits, TileTable, batch, scans_from_wire, split},
        time::timestamp,
    },
    v1::predict_grid_response::Message,
};
use tidemap_store::{Store, StoreOptions};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_stream::StreamExt as _;
use tonic::{Code, Status};

use super::*;

mod anomalies;
mod grids;
mod past;
mod surprises;
mod trained;

const MINUTE: i64 = 60_000_000_000;
/// 2016-07-01T12:00 in London.
const NOON: i64 = 1_467_370_800_000_000_000;
const LIMITS: IntakeLimits =
    IntakeLimits { batch: 4096, table: 10, scans: ScanLimits { batch_scans: 4096, points: 5000, tiles: 5000 } };

/// A daemon's maps and the service that queries them.
struct Bench {
    queries: Queries,
    handle: Arc<MapHandle>,
}

/// Two watches at once.
fn shares() -> Shares {
    Shares::new(ShareLimits { watches: (2, 2), ..ShareLimits::of(&Settings::default()) })
}

impl Bench {
    fn open(dir: &Path) -> Arc<Catalog> {
        let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
        let context = Context {
            store: Arc::new(Store::open(dir, options).expect("a store")),
            jobs: Arc::new(Jobs::default()),
            clock: Arc::new(SystemClock),
            update_turns: Arc::new(tidemap_ingest::update_turns::UpdateTurns::new(2)),
            fatal: mpsc::unbounded_channel().0,
            forks: mpsc::unbounded_channel().0,
            max_states: 10,
            max_producers: 10,
            max_producers_of_client: 10,
            max_pending: tidemap_map::live_map::PendingLimits { observations: 1_000_000, changes: 1_000_000 },
            update_readings_max: tidemap_map::update::UPDATE_READINGS_MAX,
            update_at_midnight: true,
            max_tiles: 5000,
            tile_cache_bytes: 1 << 30,
            cluster: None,
        };
        Arc::new(Catalog::open(context, 10, u64::MAX).expect("maps").0)
    }

    /// A new map `office`.
    async fn new(dir: &Path, retention: Retention, grid: Option<Retention>) -> Self {
        let catalog = Self::open(dir);
        let grid = grid.map(|retention| GridSpec { retention, ..GridSpec::new(0.1) });
        let spec = MapSpec {
            zone: Zone::named("Europe/London").expect("known"),
            retention,
            grid,
            // Predictions are compared with those of cells and of single models.
            models: EnabledModels::default().without_ensemble(),
            ..MapSpec::new(MapName::new("office").expect("valid"))
        };
        catalog.create(spec).await.expect("created");
        Self::of(catalog)
    }

    fn of(catalog: Arc<Catalog>) -> Self {
        let handle = catalog.get("office").expect("there");
        let limits = QueryLimits { predictions: 10_000, batch: 4096, trained_models: 100, training_readings: 10_000 };
        Self { queries: Queries::new(catalog, limits, shares()), handle }
    }

    /// The daemon after a restart, with the data of this one.
    async fn again(self, dir: &Path) -> Self {
        let Self { queries, handle } = self;
        queries.catalog.stop().await;
        queries.catalog.context().store.close();
        drop((queries, handle));
        Self::of(Self::open(dir))
    }

    fn context(&self) -> &Context {
        self.queries.catalog.context()
    }

    /// Learns everything.
    async fn update(&self) {
        let job = self.context().jobs.create(self.handle.spec.name.clone(), UpdateCause::Request, 0);
        let mut status = job.watch();
        assert!(self.handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job }));
        status.wait_for(|status| status.phase.has_ended()).await.expect("it ends");
    }

    async fn robot(&self, name: &str) -> Robot {
        let (sender, events) = mpsc::unbounded_channel();
        let (reply, answer) = oneshot::channel();
        let key = ProducerKey::new(name, "").expect("valid");
        let hello = Hello {
            client: String::new(),
            key,
            incarnation: 0,
            probe: None,
            takes_over: None,
            nightly: false,
            sensor: None,
            events: sender,
            reply,
        };
        assert!(self.handle.send(Command::Hello(hello)));
        let opened = answer.await.expect("an answer").expect("accepted");
        let intake = Intake::new(opened.durable_sequence, opened.content_crc, LIMITS, self.handle.spec.grid.as_ref());
        Robot { sent: opened.durable_sequence, opened, events, intake, encoder: TileTable::default() }
    }

    async fn names(&self, states: &[&str], times: &[i64]) -> Result<Vec<v1::PredictStatesResponse>, Status> {
        self.predict(states, times, None).await
    }

    async fn predict(
        &self,
        states: &[&str],
        times: &[i64],
        model: Option<v1::ModelSelector>,
    ) -> Result<Vec<v1::PredictStatesResponse>, Status> {
        let request = v1::PredictStatesRequest {
            map: "office".to_owned(),
            states: states.iter().map(ToString::to_string).collect(),
            times_nanos: times.to_vec(),
            model,
            interval_level: 0.0,
        };
        let replies = self.queries.predict_states(Request::new(request)).await?;
        replies.into_inner().collect::<Vec<_>>().await.into_iter().collect()
    }

    async fn grid(&self, request: v1::PredictGridRequest) -> Result<(v1::GridHeader, Vec<v1::GridPage>), Status> {
        let request = v1::PredictGridRequest { map: "office".to_owned(), ..request };
        let mut replies = self.queries.predict_grid(Request::new(request)).await?.into_inner();
        let Some(Message::Header(header)) = replies.next().await.expect("a reply")?.message else {
            panic!("no header first");
        };
        let mut pages = Vec::new();
        while let Some(reply) = replies.next().await {
            let Some(Message::Page(page)) = reply?.message else { panic!("no page") };
            pages.push(page);
        }
        Ok((header, pages))
    }

    async fn past(&self, state: &str, from_nanos: i64, to_nanos: i64) -> Result<Vec<(i64, f64)>, Status> {
        let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
        let request = v1::ReconstructRequest { map: "office".to_owned(), state: state.to_owned(), from_time, to_time };
        let mut replies = self.queries.reconstruct(Request::new(request)).await?.into_inner();
        let mut found = Vec::new();
        while let Some(reply) = replies.next().await {
            let reply = reply?;
            assert_eq!(reply.times_nanos.len(), reply.values.len());
            found.extend(reply.times_nanos.into_iter().zip(reply.values));
        }
        Ok(found)
    }
}

/// The tiles of a scan.
type Shown = Vec<(TileIndex, TileMasks)>;

struct Robot {
    opened: Welcome,
    sent: u64,
    events: mpsc::UnboundedReceiver<SessionEvent>,
    intake: Intake,
    encoder: TileTable,
}

fn permit() -> tokio::sync::OwnedSemaphorePermit {
    Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free")
}

impl Robot {
    /// Sends observations of the state `door` and waits until they are acknowledged.
    async fn observe(&mut self, bench: &Bench, observed: &[(i64, f64)]) {
        let new_names = match self.sent == self.opened.durable_sequence {
            true => vec![Some(StateName::new("door").expect("valid").into())],
            false => Vec::new(),
        };
        let first_sequence = self.sent + 1;
        self.sent += observed.len() as u64;
        let batch = ObservationBatch {
            span: SequenceSpan { first: first_sequence, last: self.sent, content_crc: 1 },
            new_names,
            table_indices: vec![0; observed.len()],
            times_nanos: observed.iter().map(|(time, _)| *time).collect(),
            values: observed.iter().map(|(_, value)| *value).collect(),
            ..ObservationBatch::default()
        };
        let session = self.opened.session;
        assert!(
            bench
                .handle
                .send(Command::StreamData { session, data: StreamData::Observations(batch, vec![permit(), permit()]) })
        );
        self.settled().await;
    }

    /// Sends scans and waits until they are acknowledged.
    async fn show(&mut self, bench: &Bench, scans: &[(i64, Shown)]) {
        let times: Vec<i64> = scans.iter().map(|(time, _)| *time).collect();
        let encoded = scans.iter().map(|(_, shown)| self.encoder.encode(shown).expect("tiles")).collect();
        for message in split(batch(self.sent + 1, &times, encoded), 1 << 20) {
            self.intake.begin_scans(scans_from_wire(message).expect("well formed")).expect("well formed");
            while let Some(batch) = self.intake.next_scans().expect("well formed") {
                self.sent = batch.span.last;
                let session = self.opened.session;
                assert!(
                    bench.handle.send(Command::StreamData {
                        session,
                        data: StreamData::Scans(batch, vec![permit(), permit()])
                    })
                );
            }
        }
        self.settled().await;
    }

    async fn settled(&mut self) {
        loop {
            match self.events.recv().await {
                Some(SessionEvent::Ack { durable_sequence, refused }) => {
                    assert_eq!(refused, []);
                    if durable_sequence == self.sent {
                        return;
                    }
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

fn tile(x: i32, y: i32, z: i32) -> TileIndex {
    TileIndex { x, y, z }
}

fn cells(cells: &[u16]) -> Mask {
    let mut mask = Mask::EMPTY;
    cells.iter().for_each(|&cell| mask.insert(cell));
    mask
}

/// Scans every minute of cells 0 to 3 of the first tile: cell 1 is occupied, cell 2 every other hour, and cell 3 is
/// seen every fifth minute.
fn minutes(count: usize) -> Vec<(i64, Shown)> {
    let at = |minute: usize| {
        let observed = if minute.is_multiple_of(5) { cells(&[0, 1, 2, 3]) } else { cells(&[0, 1, 2]) };
        let occupied = if minute / 60 % 2 == 1 { cells(&[1, 2]) } else { cells(&[1]) };
        (NOON + minute as i64 * MINUTE, vec![(tile(0, 0, 0), TileMasks::clipped(observed, occupied))])
    };
    (0..count).map(at).collect()
}

#[track_caller]
fn check_refused<T: std::fmt::Debug>(result: Result<T, Status>, code: Code, words: &[&str]) {
    let status = result.expect_err("refused");
    assert_eq!(status.code(), code, "{status:?}");
    for word in words {
        assert!(status.message().contains(word), "{} lacks {word}", status.message());
    }
}
