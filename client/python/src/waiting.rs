//! Waiting for the daemon without holding the interpreter.
//!
//! Invariant: a wait that Python interrupts ends at once, and drops its future. A process has a runtime of its own:
//! after a fork, the threads of the parent do not exist.

use std::{
    future::Future,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use pyo3::{exceptions::PyRuntimeError, prelude::*};
use tokio::runtime::{Builder, Runtime};

use crate::failure;

/// The interval of the checks whether Ctrl-C was pressed.
const SIGNALS_EVERY: Duration = Duration::from_millis(50);

/// The process that made something which has threads or connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Maker(u32);

impl Maker {
    /// This process.
    pub(crate) fn here() -> Self {
        Self(std::process::id())
    }

    /// Refuses what another process has made: it was copied by a fork, and its connections have no answering thread.
    pub(crate) fn check(self, py: Python<'_>, what: &str) -> PyResult<()> {
        if self == Self::here() {
            return Ok(());
        }
        let message = format!("the {what} was opened before this process was forked: open another one in this process");
        Err(failure::exception(py, "FAILED_PRECONDITION", &message))
    }
}

/// The runtime of a process. It is never dropped: a child of a fork has no threads that it could end.
static RUNTIME: Mutex<Option<(Maker, &'static Runtime)>> = Mutex::new(None);

/// The runtime of all clients of the process.
pub(crate) fn runtime() -> PyResult<&'static Runtime> {
    // This lock is held only with the interpreter's lock. A fork by Python holds the interpreter's lock, too, so that
    // no child finds this lock held.
    let mut held = RUNTIME.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((maker, runtime)) = *held
        && maker == Maker::here()
    {
        return Ok(runtime);
    }
    let runtime = Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("tidemap")
        .enable_all()
        .build()
        .map_err(|error| PyRuntimeError::new_err(format!("no threads for the client: {error}")))?;
    let runtime: &'static Runtime = Box::leak(Box::new(runtime));
    *held = Some((Maker::here(), runtime));
    Ok(runtime)
}

/// Waits for a future while other threads of Python run. `each` is called with the interpreter, about twenty times a
/// second.
pub(crate) fn wait<T: Send + 'static>(
    py: Python<'_>,
    future: impl Future<Output = T> + Send + 'static,
    mut each: impl FnMut(Python<'_>) -> PyResult<()>,
) -> PyResult<T> {
    let runtime = runtime()?;
    let mut task = runtime.spawn(future);
    loop {
        let waited = py.detach(|| runtime.block_on(async { tokio::time::timeout(SIGNALS_EVERY, &mut task).await }));
        let interrupted = match waited {
            Ok(Ok(done)) => return Ok(done),
            Ok(Err(ended)) => return Err(PyRuntimeError::new_err(format!("the client ended: {ended}"))),
            Err(_) => py.check_signals().and_then(|()| each(py)),
        };
        if let Err(interrupted) = interrupted {
            task.abort();
            return Err(interrupted);
        }
    }
}
