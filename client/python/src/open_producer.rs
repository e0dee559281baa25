//! A producer that stays open: observations, scans and traversals as they come.
//!
//! Invariant: a call that returns a number has handed its observations over; nothing is sent for a call that raises.

use std::{future::Future, pin::Pin, sync::Arc};

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::{prelude::*, types::PyDict};
use tidemap_client::{
    maps::CellBox,
    observe::{
        Phase, Producer, ProducerError, Refusal, TraversalReport,
        scan::{Isometry3, PointCloud, Quaternion, RangeScan, Scan, Translation3, UnitQuaternion},
    },
};

use crate::{
    failure, grids,
    waiting::{Maker, wait},
};

/// An edge that was driven: from, to, action, start, end, whether it succeeded, reason.
pub(crate) type Driven = (String, String, String, i64, i64, bool, String);

/// Smallest length of a quaternion that still has a direction.
const QUATERNION_MIN: f64 = 1e-6;

/// A refusal: its number, the name of its reason and the reason in words.
pub(crate) type Refused = (u64, Option<String>, String);

/// The work of a call with the producer.
type Work<'a, T> = Pin<Box<dyn Future<Output = Result<T, ProducerError>> + Send + 'a>>;

/// A producer for observations as they come; observations that it has taken are sent in the background.
#[pyclass(frozen)]
pub(crate) struct OpenProducer {
    producer: Arc<tokio::sync::Mutex<Option<Producer>>>,
    maker: Maker,
}

impl Drop for OpenProducer {
    fn drop(&mut self) {
        // In a child of a fork it is the parent's, whose threads are not there.
        if self.maker != Maker::here() {
            std::mem::forget(Arc::clone(&self.producer));
        }
    }
}

impl OpenProducer {
    pub(crate) fn new(producer: Producer) -> Self {
        Self { producer: Arc::new(tokio::sync::Mutex::new(Some(producer))), maker: Maker::here() }
    }

    /// Does something with the producer, unless it is closed.
    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Producer) -> Work<'_, T> + Send + 'static,
    ) -> PyResult<T> {
        self.maker.check(py, "producer")?;
        let producer = Arc::clone(&self.producer);
        let done = async move {
            match producer.lock().await.as_mut() {
                Some(producer) => work(producer).await,
                None => Err(ProducerError::Closed),
            }
        };
        wait(py, done, |_| Ok(()))?.map_err(|error| failure::producer(py, &error))
    }

    fn scan(&self, py: Python<'_>, time_nanos: i64, scan: Scan) -> PyResult<u64> {
        self.with(py, move |producer| Box::pin(producer.send_scan(time_nanos, scan)))
    }
}

/// The pose of x, y, z in metres and a quaternion x, y, z, w.
pub(crate) fn pose_from(py: Python<'_>, [x, y, z, qx, qy, qz, qw]: [f64; 7]) -> PyResult<Isometry3<f64>> {
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if ![x, y, z].iter().all(|metres| metres.is_finite()) || !quaternion.norm().is_finite() {
        return Err(failure::invalid(py, &format!("the pose {x}, {y}, {z}, {qx}, {qy}, {qz}, {qw} is not finite")));
    }
    if quaternion.norm() < QUATERNION_MIN {
        return Err(failure::invalid(py, "the quaternion of the pose is 0, 0, 0, 0: no turn is 0, 0, 0, 1"));
    }
    let turn = UnitQuaternion::from_quaternion(quaternion);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), turn))
}

#[pymethods]
impl OpenProducer {
    /// Takes an observation and returns its number; it is durable after `flush`.
    fn send(&self, py: Python<'_>, state: String, time_nanos: i64, value: f64) -> PyResult<u64> {
        self.with(py, move |producer| Box::pin(async move { producer.send(&state, time_nanos, value).await }))
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
        self.scan(py, time_nanos, Scan::Ranges(scan))
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
        self.scan(py, time_nanos, Scan::Cloud(cloud))
    }

    /// Takes a grid that was seen: axes z, y, x; below 0 not seen, 0 free, above 0 occupied. The map remembers its
    /// size.
    fn send_grid(
        &self,
        py: Python<'_>,
        time_nanos: i64,
        cells: PyReadonlyArray3<'_, i8>,
        first_cell: [i32; 3],
    ) -> PyResult<u64> {
        let scan = seen_map(py, &cells, first_cell)?;
        self.scan(py, time_nanos, scan)
    }

    /// Takes a label of a categorical state.
    fn send_label(&self, py: Python<'_>, state: String, time_nanos: i64, label: String) -> PyResult<u64> {
        self.with(py, move |producer| Box::pin(async move { producer.send_label(&state, time_nanos, &label).await }))
    }

    /// Takes a position: the coordinates x and y, or x, y and z, in metres.
    fn send_position(&self, py: Python<'_>, state: String, time_nanos: i64, coordinates: Vec<f64>) -> PyResult<u64> {
        self.with(py, move |producer| {
            Box::pin(async move { producer.send_position(&state, time_nanos, &coordinates).await })
        })
    }

    /// Takes a traversal of an edge.
    fn send_traversal(&self, py: Python<'_>, driven: Driven) -> PyResult<u64> {
        let report = traversal(driven);
        self.with(py, move |producer| Box::pin(async move { producer.send_traversal(&report).await }))
    }

    /// The progress: `phase` is connecting, connected, waiting or ended; `error` is the reason for waiting or for the
    /// end.
    fn progress<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let known = |producer: &mut Producer| Ok((producer.progress(), producer.last_sequence()));
        let (progress, last) = self.with(py, move |producer| Box::pin(std::future::ready(known(producer))))?;
        let (phase, error) = match &progress.phase {
            Phase::Connecting => ("connecting", None),
            Phase::Connected => ("connected", None),
            Phase::Waiting(error) => ("waiting", Some(error.to_string())),
            Phase::Ended(error) => ("ended", Some(error.to_string())),
        };
        let found = PyDict::new(py);
        found.set_item("phase", phase)?;
        found.set_item("error", error)?;
        found.set_item("durable_sequence", progress.durable_sequence)?;
        found.set_item("last_sequence", last)?;
        found.set_item("store_id", progress.store_id)?;
        found.set_item("unreported", progress.unreported)?;
        found.set_item("dropped_refusals", progress.dropped_refusals)?;
        Ok(found)
    }

    /// The refusals since the last call.
    fn take_refusals(&self, py: Python<'_>) -> PyResult<Vec<Refused>> {
        let taken = self.with(py, |producer| Box::pin(std::future::ready(Ok(producer.take_refusals()))))?;
        Ok(taken.into_iter().map(refused).collect())
    }

    /// Waits until everything that was taken is durable, and returns the number of the last.
    fn flush(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |producer| Box::pin(async { Ok(producer.flush().await?.durable_sequence) }))
    }

    /// Waits until everything is durable, and ends.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.maker.check(py, "producer")?;
        let producer = Arc::clone(&self.producer);
        let closed = async move {
            let mut held = producer.lock().await;
            let Some(producer) = held.as_mut() else { return Ok(()) };
            producer.close().await?;
            *held = None;
            Ok(())
        };
        wait(py, closed, |_| Ok(()))?.map_err(|error| failure::producer(py, &error))
    }

    /// Ends at once; observations that are not durable may or may not become durable.
    fn abandon(&self, py: Python<'_>) -> PyResult<()> {
        self.maker.check(py, "producer")?;
        let producer = Arc::clone(&self.producer);
        wait(py, async move { drop(producer.lock().await.take()) }, |_| Ok(()))
    }
}

/// A refusal for Python.
pub(crate) fn refused(refusal: Refusal) -> Refused {
    (refusal.sequence, refusal.reason.map(|reason| format!("{reason:?}")), refusal.detail)
}

/// A traversal of Python.
pub(crate) fn traversal((from, to, action, start_nanos, end_nanos, success, reason): Driven) -> TraversalReport {
    TraversalReport { from, to, action, start_nanos, end_nanos, success, reason }
}

/// The points of a cloud: rows x, y, z.
pub(crate) fn points_of(py: Python<'_>, xyz_m: &PyReadonlyArray2<'_, f32>) -> PyResult<Vec<f32>> {
    let points = xyz_m.as_array();
    if points.ncols() != 3 {
        let message = format!("points with {} coordinates: they have three, x, y and z", points.ncols());
        return Err(failure::invalid(py, &message));
    }
    Ok(points.iter().copied().collect())
}

/// A grid that was seen, in cells of the map; axes z, y, x.
pub(crate) fn seen_map(py: Python<'_>, cells: &PyReadonlyArray3<'_, i8>, first_cell: [i32; 3]) -> PyResult<Scan> {
    let cells = cells.as_array();
    let Some(shown) = shown(cells.shape(), first_cell) else {
        let message = format!("a grid of {:?} cells from cell {first_cell:?} does not exist", cells.shape());
        return Err(failure::invalid(py, &message));
    };
    Ok(Scan::Map { tiles: grids::seen_tiles(cells, first_cell), shown })
}

/// The cells of a grid of this shape (z, y, x); `None`: their indices do not exist.
fn shown(shape: &[usize], first_cell: [i32; 3]) -> Option<CellBox> {
    let [x, y, z] = first_cell;
    let end = |first: i32, axis: usize| first.checked_add(i32::try_from(*shape.get(axis)?).ok()?);
    Some(grids::cell_box([x, y, z, end(x, 2)?, end(y, 1)?, end(z, 0)?]))
}
