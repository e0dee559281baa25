//! The producer with a durable queue for C++; `include/tidemap/queue.hpp` is its interface for programs.
//!
//! Invariant: a call whose reply has no problem has put its observation into the files. No panic crosses the border: a
//! call of this library returns its problem.

use std::{fmt::Display, fs, path::PathBuf, time::Duration};

use tidemap_client::{
    Client,
    connection::Credentials,
    observe::{
        ProducerOptions, QueueError, QueueOptions, QueuedProducer, SightingReport, TraversalReport,
        occupancy::OccupancyGrid,
        scan::{Isometry3, PointCloud, Quaternion, RangeScan, Scan, Translation3, UnitQuaternion},
    },
};
use tokio::runtime::{Builder, Runtime};

/// Smallest length of a quaternion that still has a direction.
const QUATERNION_MIN: f64 = 1e-6;

#[cxx::bridge(namespace = "tidemap::native")]
mod ffi {
    /// The kind of a problem, for programs.
    enum Problem {
        None,
        Invalid,
        Full,
        InUse,
        Damaged,
        Closed,
        StillWaiting,
        Other,
    }

    /// The number of an observation, or the problem.
    struct Reply {
        number: u64,
        problem: Problem,
        message: String,
    }

    struct Options {
        server: String,
        token: String,
        ca_file: String,
        certificate_file: String,
        key_file: String,
        map: String,
        producer: String,
        label: String,
        folder: String,
        bytes_max: u64,
        sync_secs: f64,
    }

    struct Position {
        x_m: f64,
        y_m: f64,
        z_m: f64,
        qx: f64,
        qy: f64,
        qz: f64,
        qw: f64,
    }

    struct Counts {
        connected: bool,
        error: String,
        last: u64,
        waiting: u64,
        oldest_waiting_nanos: i64,
        bytes: u64,
        bytes_max: u64,
        durable: u64,
        refused: u64,
        last_refusal: String,
        unreported: u64,
        unsendable: u64,
        last_unsendable: String,
        not_taken: u64,
        lost: u64,
        cut_bytes: u64,
    }

    struct Refused {
        number: u64,
        reason: String,
        detail: String,
    }

    extern "Rust" {
        type Queue;

        fn closed_queue() -> Box<Queue>;
        fn open(self: &mut Queue, options: &Options) -> Reply;
        fn send(self: &Queue, state: &str, time_nanos: i64, value: f64) -> Reply;
        fn send_label(self: &Queue, state: &str, time_nanos: i64, label: &str) -> Reply;
        fn send_position(self: &Queue, state: &str, time_nanos: i64, coordinates: &[f64]) -> Reply;
        #[allow(clippy::too_many_arguments)]
        fn send_ranges(
            self: &Queue,
            time_nanos: i64,
            pose: &Position,
            frame_id: &str,
            angle_min_rad: f32,
            angle_increment_rad: f32,
            min_range_m: f32,
            max_range_m: f32,
            free_range_m: f32,
            trusted_range_m: f32,
            ranges_m: &[f32],
        ) -> Reply;
        fn send_cloud(
            self: &Queue,
            time_nanos: i64,
            pose: &Position,
            frame_id: &str,
            min_range_m: f32,
            max_range_m: f32,
            xyz_m: &[f32],
        ) -> Reply;
        fn send_occupancy(
            self: &Queue,
            time_nanos: i64,
            pose: &Position,
            resolution_m: f64,
            width: usize,
            cells: &[i8],
        ) -> Reply;
        #[allow(clippy::too_many_arguments)]
        fn send_traversal(
            self: &Queue,
            from: &str,
            to: &str,
            action: &str,
            start_nanos: i64,
            end_nanos: i64,
            success: bool,
            reason: &str,
        ) -> Reply;
        fn send_sighting(
            self: &Queue,
            place: &str,
            time_nanos: i64,
            seen: &Vec<String>,
            out_of_view: &Vec<String>,
        ) -> Reply;
        fn counts(self: &Queue) -> Counts;
        fn take_refusals(self: &Queue) -> Vec<Refused>;
        fn retry_now(self: &Queue);
        fn sync(self: &Queue) -> Reply;
        fn flush(self: &Queue, patience_secs: f64) -> Reply;
        fn close(self: &Queue) -> Reply;
    }
}

use ffi::{Counts, Options, Position, Problem, Refused, Reply};

/// A queue that is open, or has not been opened. The producer is dropped before its threads.
struct Queue {
    opened: Option<(QueuedProducer, Runtime)>,
}

fn closed_queue() -> Box<Queue> {
    Box::new(Queue { opened: None })
}

fn wrong(problem: Problem, message: impl Display) -> Reply {
    Reply { number: 0, problem, message: message.to_string() }
}

fn reply(done: Result<u64, QueueError>) -> Reply {
    let error = match done {
        Ok(number) => return Reply { number, problem: Problem::None, message: String::new() },
        Err(error) => error,
    };
    let problem = match error {
        QueueError::Full { .. } => Problem::Full,
        QueueError::InUse { .. } => Problem::InUse,
        QueueError::Damaged { .. } => Problem::Damaged,
        QueueError::Closed => Problem::Closed,
        QueueError::StillWaiting { .. } => Problem::StillWaiting,
        QueueError::Producer(_) | QueueError::Occupancy(_) | QueueError::OtherStream { .. } => Problem::Invalid,
        _ => Problem::Other,
    };
    wrong(problem, error)
}

fn pose_from(pose: &Position) -> Result<Isometry3<f64>, Reply> {
    let Position { x_m, y_m, z_m, qx, qy, qz, qw } = *pose;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if ![x_m, y_m, z_m, quaternion.norm()].iter().all(|number| number.is_finite()) {
        return Err(wrong(Problem::Invalid, "the pose has a number that is not finite"));
    }
    if quaternion.norm() < QUATERNION_MIN {
        return Err(wrong(Problem::Invalid, "the quaternion of the pose is 0, 0, 0, 0: no turn is 0, 0, 0, 1"));
    }
    Ok(Isometry3::from_parts(Translation3::new(x_m, y_m, z_m), UnitQuaternion::from_quaternion(quaternion)))
}

/// The bytes of a file; `None` if it has no name.
fn file(name: &str) -> Result<Option<Vec<u8>>, Reply> {
    if name.is_empty() {
        return Ok(None);
    }
    fs::read(name).map(Some).map_err(|error| wrong(Problem::Invalid, format!("{name}: {error}")))
}

fn opened(options: &Options) -> Result<(QueuedProducer, Runtime), Reply> {
    let identity = file(&options.certificate_file)?.zip(file(&options.key_file)?);
    let token = Some(options.token.clone()).filter(|token| !token.is_empty());
    let credentials = Credentials { token, ca: file(&options.ca_file)?, identity };
    // A client needs the runtime, too.
    let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("tidemap").enable_all().build();
    let runtime = runtime.map_err(|error| wrong(Problem::Other, format!("no threads for the queue: {error}")))?;
    let entered = runtime.enter();
    let client = Client::with_credentials(&options.server, &credentials);
    let client = client.map_err(|error| wrong(Problem::Invalid, error))?;
    let sync_every = Duration::try_from_secs_f64(options.sync_secs).ok().filter(|interval| !interval.is_zero());
    let sync_every = sync_every.ok_or_else(|| wrong(Problem::Invalid, "sync_secs: use a number above 0"))?;
    let queue = QueueOptions { folder: PathBuf::from(&options.folder), bytes_max: options.bytes_max, sync_every };
    let stream = ProducerOptions::new(&options.producer, &options.label, &options.map);
    let producer = QueuedProducer::open(&client, stream, &queue).map_err(|error| reply(Err(error)))?;
    drop(entered);
    Ok((producer, runtime))
}

impl Queue {
    fn open(&mut self, options: &Options) -> Reply {
        match opened(options) {
            Ok(opened) => {
                self.opened = Some(opened);
                reply(Ok(0))
            }
            Err(reply) => reply,
        }
    }

    fn with(&self, work: impl FnOnce(&QueuedProducer) -> Result<u64, QueueError>) -> Reply {
        reply(self.opened.as_ref().map_or(Err(QueueError::Closed), |(producer, _)| work(producer)))
    }

    fn wait(&self, work: impl AsyncFnOnce(&QueuedProducer) -> Result<u64, QueueError>) -> Reply {
        let wait = |(producer, runtime): &(QueuedProducer, Runtime)| runtime.block_on(work(producer));
        reply(self.opened.as_ref().map_or(Err(QueueError::Closed), wait))
    }

    fn send(&self, state: &str, time_nanos: i64, value: f64) -> Reply {
        self.with(|producer| producer.send(state, time_nanos, value))
    }

    fn send_label(&self, state: &str, time_nanos: i64, label: &str) -> Reply {
        self.with(|producer| producer.send_label(state, time_nanos, label))
    }

    fn send_position(&self, state: &str, time_nanos: i64, coordinates: &[f64]) -> Reply {
        self.with(|producer| producer.send_position(state, time_nanos, coordinates))
    }

    #[expect(clippy::too_many_arguments, reason = "the header names them")]
    fn send_ranges(
        &self,
        time_nanos: i64,
        pose: &Position,
        frame_id: &str,
        angle_min_rad: f32,
        angle_increment_rad: f32,
        min_range_m: f32,
        max_range_m: f32,
        free_range_m: f32,
        trusted_range_m: f32,
        ranges_m: &[f32],
    ) -> Reply {
        let pose = match pose_from(pose) {
            Ok(pose) => pose,
            Err(reply) => return reply,
        };
        let (frame_id, ranges_m) = (frame_id.to_owned(), ranges_m.to_vec());
        let scan = RangeScan {
            pose,
            frame_id,
            angle_min_rad,
            angle_increment_rad,
            ranges_m,
            min_range_m,
            max_range_m,
            free_range_m,
            trusted_range_m,
        };
        self.with(|producer| producer.send_scan(time_nanos, Scan::Ranges(scan)))
    }

    fn send_cloud(
        &self,
        time_nanos: i64,
        pose: &Position,
        frame_id: &str,
        min_range_m: f32,
        max_range_m: f32,
        xyz_m: &[f32],
    ) -> Reply {
        if !xyz_m.len().is_multiple_of(3) {
            return wrong(Problem::Invalid, format!("{} numbers: each point has three, x, y and z", xyz_m.len()));
        }
        let pose = match pose_from(pose) {
            Ok(pose) => pose,
            Err(reply) => return reply,
        };
        let cloud = PointCloud { pose, frame_id: frame_id.to_owned(), xyz_m: xyz_m.to_vec(), min_range_m, max_range_m };
        self.with(|producer| producer.send_scan(time_nanos, Scan::Cloud(cloud)))
    }

    fn send_occupancy(&self, time_nanos: i64, pose: &Position, resolution_m: f64, width: usize, cells: &[i8]) -> Reply {
        let pose = match pose_from(pose) {
            Ok(pose) => pose,
            Err(reply) => return reply,
        };
        let grid = OccupancyGrid { pose, resolution_m, width, cells: cells.to_vec() };
        self.with(|producer| producer.send_grid(time_nanos, &grid))
    }

    #[expect(clippy::too_many_arguments, reason = "the header names them")]
    fn send_traversal(
        &self,
        from: &str,
        to: &str,
        action: &str,
        start_nanos: i64,
        end_nanos: i64,
        success: bool,
        reason: &str,
    ) -> Reply {
        let [from, to, action, reason] = [from, to, action, reason].map(str::to_owned);
        let report = TraversalReport { from, to, action, start_nanos, end_nanos, success, reason };
        self.with(|producer| producer.send_traversal(&report))
    }

    #[expect(clippy::ptr_arg, reason = "the bridge passes vectors")]
    fn send_sighting(&self, place: &str, time_nanos: i64, seen: &Vec<String>, out_of_view: &Vec<String>) -> Reply {
        let report = SightingReport {
            place: place.to_owned(),
            time_nanos,
            seen: seen.clone(),
            out_of_view: out_of_view.clone(),
            ..SightingReport::default()
        };
        self.with(|producer| producer.send_sighting(&report))
    }

    fn counts(&self) -> Counts {
        let state = self.opened.as_ref().map(|(producer, _)| producer.state()).unwrap_or_default();
        Counts {
            connected: state.connected,
            error: state.error.map(|error| error.to_string()).unwrap_or_default(),
            last: state.last,
            waiting: state.waiting,
            oldest_waiting_nanos: state.oldest_waiting_nanos.unwrap_or(-1),
            bytes: state.bytes,
            bytes_max: state.bytes_max,
            durable: state.durable,
            refused: state.refused,
            last_refusal: state.last_refusal,
            unreported: state.unreported,
            unsendable: state.unsendable,
            last_unsendable: state.last_unsendable,
            not_taken: state.not_taken,
            lost: state.lost,
            cut_bytes: state.cut_bytes,
        }
    }

    fn take_refusals(&self) -> Vec<Refused> {
        let taken = self.opened.as_ref().map(|(producer, _)| producer.take_refusals()).unwrap_or_default();
        let shown = |refusal: tidemap_client::observe::Refusal| Refused {
            number: refusal.sequence,
            reason: refusal.reason.map(|reason| format!("{reason:?}")).unwrap_or_default(),
            detail: refusal.detail,
        };
        taken.into_iter().map(shown).collect()
    }

    fn retry_now(&self) {
        if let Some((producer, _)) = &self.opened {
            producer.retry_now();
        }
    }

    fn sync(&self) -> Reply {
        self.wait(async |producer| producer.sync().await.map(|()| 0))
    }

    fn flush(&self, patience_secs: f64) -> Reply {
        let Ok(patience) = Duration::try_from_secs_f64(patience_secs) else {
            return wrong(Problem::Invalid, format!("a patience of {patience_secs} s: use 0 or more seconds"));
        };
        self.wait(async move |producer| producer.flush(patience).await)
    }

    fn close(&self) -> Reply {
        self.wait(async |producer| producer.close().await.map(|()| 0))
    }
}
