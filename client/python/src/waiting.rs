//! Waiting for the daemon without holding the interpreter.
//!
//! Invariant: a wait that Python interrupts ends at once, and drops what it waited for.

use std::{future::Future, sync::OnceLock, time::Duration};

use pyo3::{exceptions::PyRuntimeError, prelude::*};
use tokio::runtime::{Builder, Runtime};

/// How often Python is asked whether Ctrl-C was pressed.
const SIGNALS_EVERY: Duration = Duration::from_millis(50);

/// The runtime of all clients of the process.
pub(crate) fn runtime() -> PyResult<&'static Runtime> {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    if let Some(runtime) = RUNTIME.get() {
        return Ok(runtime);
    }
    let runtime = Builder::new_multi_thread()
        .worker_threads(2)
        .thread_name("tidemap")
        .enable_all()
        .build()
        .map_err(|error| PyRuntimeError::new_err(format!("no threads for the client: {error}")))?;
    Ok(RUNTIME.get_or_init(|| runtime))
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
