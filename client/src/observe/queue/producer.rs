//! [`QueuedProducer`]: the handle by which a program puts its observations into the queue.
//!
//! Invariant: a call that returns a number has put its observation into the files; sending needs no further call.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use prost::Message as _;
use tidemap_model::Position;
use tokio::{sync::watch, task::JoinHandle};

use super::{
    QueueOptions, QueueState,
    error::QueueError,
    folder::QueueFolder,
    record::{GridRecord, PositionRecord, QueuedRecord, RecordContent, ValueRecord},
    sender::QueueSender,
    state::QueueShared,
};
use crate::{
    connection::Client,
    observe::{
        ProducerError, ProducerOptions, Refusal, STATE_NAME_BYTES_MAX, SightingReport, TraversalReport,
        occupancy::OccupancyGrid, producer::label_name, scan::Scan,
    },
};

/// Takes observations of one producer and label into files, and sends them to one map, each exactly once.
///
/// The daemon does not have to be reachable: what was taken waits in the files and is sent later, in order, also by the
/// next run of this program. The handle may be shared between threads.
///
/// ```no_run
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use tidemap_client::{Client, observe::{ProducerOptions, QueueOptions, QueuedProducer}};
/// let client = Client::new("10.0.0.5:7435")?;
/// let options = ProducerOptions::new("robot-1", "", "office");
/// let producer = QueuedProducer::open(&client, options, &QueueOptions::new("/var/lib/robot/queue"))?;
/// producer.send("door", 1_458_518_400_000_000_000, 1.0)?; // kept from here on, with or without a network
/// println!("{} observations wait", producer.state().waiting);
/// producer.close().await?; // all is on the disk; the rest is sent by the next run
/// # Ok(()) }
/// ```
#[derive(Debug)]
pub struct QueuedProducer {
    shared: Arc<QueueShared>,
    tasks: [JoinHandle<()>; 2],
}

impl QueuedProducer {
    /// Opens the queue and starts to send; does not wait for the daemon. Call it in a runtime of tokio.
    /// [`ProducerOptions::patience`] is not used: the queue tries for as long as it is open.
    ///
    /// # Errors
    /// [`QueueError`] if the folder cannot be used.
    pub fn open(client: &Client, options: ProducerOptions, queue: &QueueOptions) -> Result<Self, QueueError> {
        let stream = [&*options.map, &*options.producer, &*options.label];
        let folder = QueueFolder::open(&queue.folder, queue.bytes_max, stream)?;
        let shared = Arc::new(QueueShared::new(folder));
        let sender = QueueSender::new(client.clone(), options, Arc::clone(&shared));
        let synced = sync_every(queue.sync_every, Arc::clone(&shared));
        Ok(Self { shared, tasks: [tokio::spawn(sender.run()), tokio::spawn(synced)] })
    }

    /// Takes an observation and returns its number in the queue.
    ///
    /// # Errors
    /// [`QueueError`]; the observation is then not taken.
    pub fn send(&self, state: &str, time_nanos: i64, value: f64) -> Result<u64, QueueError> {
        check_name(state)?;
        self.take(time_nanos, RecordContent::Value(ValueRecord { state: state.to_owned(), value }))
    }

    /// Does the same as [`QueuedProducer::send`], for a vector: the coordinates in metres, x and y, or x, y and z.
    ///
    /// # Errors
    /// [`QueueError`]; the observation is then not taken.
    pub fn send_position(&self, state: &str, time_nanos: i64, coordinates: &[f64]) -> Result<u64, QueueError> {
        check_name(state)?;
        if Position::of(coordinates).is_none() {
            return Err(ProducerError::Coordinates(coordinates.len()).into());
        }
        let record = PositionRecord { state: state.to_owned(), coordinates: coordinates.to_vec() };
        self.take(time_nanos, RecordContent::Position(record))
    }

    /// Does the same as [`QueuedProducer::send`], for a categorical state: sends the label that holds.
    ///
    /// # Errors
    /// [`QueueError`]; the observation is then not taken.
    pub fn send_label(&self, state: &str, time_nanos: i64, label: &str) -> Result<u64, QueueError> {
        let name = label_name(state, label);
        check_name(&name)?;
        self.take(time_nanos, RecordContent::Label(name))
    }

    /// Takes a scan and returns its number in the queue.
    ///
    /// # Errors
    /// [`QueueError`]; the scan is then not taken.
    pub fn send_scan(&self, time_nanos: i64, scan: Scan) -> Result<u64, QueueError> {
        self.take(time_nanos, scan.into())
    }

    /// Takes a grid with a pose and a resolution of its own, and returns its number in the queue. It becomes cells of
    /// the map when the daemon has been reached.
    ///
    /// # Errors
    /// [`QueueError`]; the grid is then not taken.
    pub fn send_grid(&self, time_nanos: i64, grid: &OccupancyGrid) -> Result<u64, QueueError> {
        grid.check()?;
        self.take(time_nanos, RecordContent::Grid(GridRecord::new(grid)))
    }

    /// Takes a traversal and returns its number in the queue.
    ///
    /// # Errors
    /// [`QueueError`]; the traversal is then not taken.
    pub fn send_traversal(&self, report: &TraversalReport) -> Result<u64, QueueError> {
        let TraversalReport { from, to, action, .. } = report;
        [from, to, action].into_iter().try_for_each(|name| check_name(name))?;
        self.take(report.start_nanos, RecordContent::Report(report.to_report()))
    }

    /// Takes a sighting and returns its number in the queue.
    ///
    /// # Errors
    /// [`QueueError`]; the sighting is then not taken.
    pub fn send_sighting(&self, report: &SightingReport) -> Result<u64, QueueError> {
        let SightingReport { place, seen, out_of_view, .. } = report;
        seen.iter().chain(out_of_view).chain([place]).try_for_each(|name| check_name(name))?;
        self.take(report.time_nanos, RecordContent::Report(report.to_report()))
    }

    fn take(&self, time_nanos: i64, content: RecordContent) -> Result<u64, QueueError> {
        if time_nanos < 0 {
            return Err(ProducerError::TimeBefore1970(time_nanos).into());
        }
        let taken = self.shared.folder.append(&QueuedRecord::new(time_nanos, content).encode_to_vec());
        match &taken {
            Ok(_) => self.shared.grown.notify_one(),
            Err(_) => self.shared.underway().state.not_taken += 1,
        }
        taken
    }

    /// The counts now.
    #[must_use]
    pub fn state(&self) -> QueueState {
        self.shared.state()
    }

    /// Watches the number up to which the daemon has the observations, or has refused them.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.shared.durable.subscribe()
    }

    /// The refusals that arrived since the last call, in order, by their number in the queue; at most 65,536 are kept.
    #[must_use]
    pub fn take_refusals(&self) -> Vec<Refusal> {
        std::mem::take(&mut self.shared.underway().refusals)
    }

    /// Tries to reach the daemon now, without the pause after a failure.
    pub fn retry_now(&self) {
        self.shared.retry.notify_one();
    }

    /// Forces everything that was taken so far to the disk: it survives a power cut from here on.
    ///
    /// # Errors
    /// [`QueueError::NotSynced`].
    pub async fn sync(&self) -> Result<(), QueueError> {
        synced(&self.shared).await
    }

    /// Waits until the daemon has everything that was taken so far, or has refused it, for at most `patience`. Returns
    /// the number of the last observation.
    ///
    /// # Errors
    /// [`QueueError::StillWaiting`]; everything is kept, and still sent.
    pub async fn flush(&self, patience: Duration) -> Result<u64, QueueError> {
        let began = Instant::now();
        let last = self.shared.folder.counts().last;
        let mut durable = self.watch();
        let reached = durable.wait_for(|durable| *durable >= last);
        match tokio::time::timeout(patience, reached).await {
            Ok(_) => Ok(last),
            Err(_) => Err(QueueError::StillWaiting {
                waiting: last.saturating_sub(*self.shared.durable.borrow()),
                waited_secs: began.elapsed().as_secs(),
            }),
        }
    }

    /// Ends sending, and forces everything to the disk; does not wait for the daemon. The next run sends the rest.
    ///
    /// # Errors
    /// [`QueueError`] if the disk fails.
    pub async fn close(&self) -> Result<(), QueueError> {
        self.tasks.iter().for_each(JoinHandle::abort);
        let shared = Arc::clone(&self.shared);
        tokio::task::spawn_blocking(move || shared.folder.close()).await.map_err(|_| QueueError::Closed)?
    }
}

impl Drop for QueuedProducer {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
        // The caller cannot be reached any more; what was taken is in the files.
        let _ = self.shared.folder.close();
    }
}

fn check_name(name: &str) -> Result<(), QueueError> {
    if name.len() > STATE_NAME_BYTES_MAX { Err(ProducerError::NameTooLong(name.len()).into()) } else { Ok(()) }
}

async fn synced(shared: &Arc<QueueShared>) -> Result<(), QueueError> {
    let shared = Arc::clone(shared);
    tokio::task::spawn_blocking(move || shared.folder.sync()).await.map_err(|_| QueueError::Closed)?
}

/// Forces what was taken to the disk at an interval. An error is shown until the disk works again.
async fn sync_every(interval: Duration, shared: Arc<QueueShared>) {
    loop {
        tokio::time::sleep(interval).await;
        let ended = synced(&shared).await;
        let mut underway = shared.underway();
        match ended {
            Err(error) => underway.state.error = Some(error),
            Ok(()) if matches!(underway.state.error, Some(QueueError::NotSynced(_))) => underway.state.error = None,
            Ok(()) => {}
        }
    }
}
