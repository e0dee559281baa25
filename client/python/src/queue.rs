//! A producer whose observations wait in files until the daemon has them.
//!
//! Invariant: a call that returns a number has put its observation into the files; a call that raises has not.

use std::{sync::Arc, time::Duration};

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{prelude::*, types::PyDict};
use tidemap_client::observe::{
    QueueError, QueueState, QueuedProducer,
    occupancy::OccupancyGrid,
    scan::{PointCloud, RangeScan, Scan},
};

use crate::{
    failure,
    open_producer::{Driven, Refused, points_of, pose_from, refused, seen_map, traversal},
    waiting::{Maker, wait},
};

/// A wait without an end, which Ctrl-C ends.
const FOREVER: Duration = Duration::from_secs(100 * 365 * 86_400);

/// A producer with a queue on the disk.
#[pyclass(frozen)]
pub(crate) struct NativeQueue {
    producer: Arc<QueuedProducer>,
    maker: Maker,
}

impl Drop for NativeQueue {
    fn drop(&mut self) {
        // In a child of a fork the files are the parent's.
        if self.maker != Maker::here() {
            std::mem::forget(Arc::clone(&self.producer));
        }
    }
}

impl NativeQueue {
    pub(crate) fn new(producer: QueuedProducer) -> Self {
        Self { producer: Arc::new(producer), maker: Maker::here() }
    }

    /// Does something with the queue while other threads of Python run.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&QueuedProducer) -> Result<T, QueueError> + Send,
    ) -> PyResult<T> {
        self.maker.check(py, "producer")?;
        py.detach(|| work(&self.producer)).map_err(|error| failure::queue(py, &error))
    }

    fn state_now(&self, py: Python<'_>) -> PyResult<QueueState> {
        self.with(py, |producer| Ok(producer.state()))
    }
}

#[pymethods]
impl NativeQueue {
    /// Takes an observation and returns its number.
    fn send(&self, py: Python<'_>, state: &str, time_nanos: i64, value: f64) -> PyResult<u64> {
        self.with(py, |producer| producer.send(state, time_nanos, value))
    }

    /// Takes a label of a categorical state.
    fn send_label(&self, py: Python<'_>, state: &str, time_nanos: i64, label: &str) -> PyResult<u64> {
        self.with(py, |producer| producer.send_label(state, time_nanos, label))
    }

    /// Takes a position: the coordinates x and y, or x, y and z, in metres.
    fn send_position(&self, py: Python<'_>, state: &str, time_nanos: i64, coordinates: Vec<f64>) -> PyResult<u64> {
        self.with(py, |producer| producer.send_position(state, time_nanos, &coordinates))
    }

    /// Takes a scan of a planar range finder; pose: x, y, z, and a quaternion x, y, z, w.
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn send_ranges(
        &self,
        py: Python<'_>,
        time_nanos: i64,
        pose: [f64; 7],
        angle_min_rad: f32,
        angle_increment_rad: f32,
        ranges_m: PyReadonlyArray1<'_, f32>,
        min_range_m: f32,
        max_range_m: f32,
        free_range_m: f32,
        trusted_range_m: f32,
        frame_id: String,
    ) -> PyResult<u64> {
        let scan = RangeScan {
            pose: pose_from(py, pose)?,
            frame_id,
            angle_min_rad,
            angle_increment_rad,
            ranges_m: ranges_m.as_array().to_vec(),
            min_range_m,
            max_range_m,
            free_range_m,
            trusted_range_m,
        };
        self.with(py, |producer| producer.send_scan(time_nanos, Scan::Ranges(scan)))
    }

    /// Takes a point cloud in the frame of the sensor: rows x, y, z.
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn send_cloud(
        &self,
        py: Python<'_>,
        time_nanos: i64,
        pose: [f64; 7],
        xyz_m: PyReadonlyArray2<'_, f32>,
        min_range_m: f32,
        max_range_m: f32,
        frame_id: String,
    ) -> PyResult<u64> {
        let cloud = PointCloud {
            pose: pose_from(py, pose)?,
            frame_id,
            xyz_m: points_of(py, &xyz_m)?,
            min_range_m,
            max_range_m,
        };
        self.with(py, |producer| producer.send_scan(time_nanos, Scan::Cloud(cloud)))
    }

    /// Takes a grid that was seen, in cells of the map: axes z, y, x; below 0 not seen, 0 free, above 0 occupied.
    fn send_grid(
        &self,
        py: Python<'_>,
        time_nanos: i64,
        cells: PyReadonlyArray3<'_, i8>,
        first_cell: [i32; 3],
    ) -> PyResult<u64> {
        let scan = seen_map(py, &cells, first_cell)?;
        self.with(py, |producer| producer.send_scan(time_nanos, scan))
    }

    /// Takes a grid with a pose and a resolution of its own: axes y, x.
    fn send_occupancy(
        &self,
        py: Python<'_>,
        time_nanos: i64,
        pose: [f64; 7],
        resolution_m: f64,
        cells: PyReadonlyArray2<'_, i8>,
    ) -> PyResult<u64> {
        let cells = cells.as_array();
        let width = cells.ncols();
        let cells = cells.iter().copied().collect();
        let grid = OccupancyGrid { pose: pose_from(py, pose)?, resolution_m, width, cells };
        self.with(py, |producer| producer.send_grid(time_nanos, &grid))
    }

    /// Takes a traversal of an edge.
    fn send_traversal(&self, py: Python<'_>, driven: Driven) -> PyResult<u64> {
        self.with(py, |producer| producer.send_traversal(&traversal(driven)))
    }

    /// The counts.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let state = self.state_now(py)?;
        let mut reasons: Vec<(String, u64)> = Vec::new();
        for (reason, count) in state.refused_by_reason {
            reasons.push((reason.map_or_else(|| "unknown".to_owned(), |reason| format!("{reason:?}")), count));
        }
        let found = PyDict::new(py);
        found.set_item("connected", state.connected)?;
        found.set_item("error", state.error.map(|error| error.to_string()))?;
        found.set_item("last", state.last)?;
        found.set_item("waiting", state.waiting)?;
        found.set_item("oldest_waiting_nanos", state.oldest_waiting_nanos)?;
        found.set_item("bytes", state.bytes)?;
        found.set_item("bytes_max", state.bytes_max)?;
        found.set_item("durable", state.durable)?;
        found.set_item("refused", state.refused)?;
        found.set_item("refused_by_reason", reasons.into_iter().collect::<std::collections::BTreeMap<_, _>>())?;
        found.set_item("last_refusal", state.last_refusal)?;
        found.set_item("unreported", state.unreported)?;
        found.set_item("unsendable", state.unsendable)?;
        found.set_item("last_unsendable", state.last_unsendable)?;
        found.set_item("not_taken", state.not_taken)?;
        found.set_item("lost", state.lost)?;
        found.set_item("cut_bytes", state.cut_bytes)?;
        let grid = state.grid;
        found.set_item("resolution_m", grid.as_ref().map(|grid| grid.resolution_m))?;
        found.set_item("origin_m", grid.as_ref().map(|grid| <(f64, f64, f64)>::from(grid.origin_m)))?;
        Ok(found)
    }

    /// The progress, as of a producer without a queue; the numbers are those of the queue.
    fn progress<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let state = self.state_now(py)?;
        let found = PyDict::new(py);
        let phase = match (state.connected, &state.error) {
            (true, _) => "connected",
            (false, None) => "connecting",
            (false, Some(QueueError::Closed)) => "ended",
            (false, Some(_)) => "waiting",
        };
        found.set_item("phase", phase)?;
        found.set_item("error", state.error.map(|error| error.to_string()))?;
        found.set_item("durable_sequence", state.last - state.waiting.min(state.last))?;
        found.set_item("last_sequence", state.last)?;
        found.set_item("store_id", "")?;
        found.set_item("unreported", state.unreported)?;
        found.set_item("dropped_refusals", 0)?;
        Ok(found)
    }

    /// The refusals since the last call.
    fn take_refusals(&self, py: Python<'_>) -> PyResult<Vec<Refused>> {
        Ok(self.with(py, |producer| Ok(producer.take_refusals()))?.into_iter().map(refused).collect())
    }

    /// Tries to reach the daemon now.
    fn retry_now(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |producer| {
            producer.retry_now();
            Ok(())
        })
    }

    /// Forces everything that was taken to the disk.
    fn sync(&self, py: Python<'_>) -> PyResult<()> {
        self.maker.check(py, "producer")?;
        let producer = Arc::clone(&self.producer);
        let synced = wait(py, async move { producer.sync().await }, |_| Ok(()))?;
        synced.map_err(|error| failure::queue(py, &error))
    }

    /// Waits until the daemon has everything that was taken, and returns the number of the last.
    #[pyo3(signature = (patience_secs=None))]
    fn flush(&self, py: Python<'_>, patience_secs: Option<f64>) -> PyResult<u64> {
        self.maker.check(py, "producer")?;
        let patience = patience_secs.map_or(Ok(FOREVER), Duration::try_from_secs_f64);
        let Ok(patience) = patience else {
            return Err(failure::invalid(py, &format!("a patience of {patience_secs:?} s: use 0 or more seconds")));
        };
        let producer = Arc::clone(&self.producer);
        let flushed = wait(py, async move { producer.flush(patience.min(FOREVER)).await }, |_| Ok(()))?;
        flushed.map_err(|error| failure::queue(py, &error))
    }

    /// Ends sending, and forces everything to the disk; what waits is sent by the next run.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.maker.check(py, "producer")?;
        let producer = Arc::clone(&self.producer);
        let closed = wait(py, async move { producer.close().await }, |_| Ok(()))?;
        closed.map_err(|error| failure::queue(py, &error))
    }

    /// Does the same as `close`.
    fn abandon(&self, py: Python<'_>) -> PyResult<()> {
        self.close(py)
    }
}
