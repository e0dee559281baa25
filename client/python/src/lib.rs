//! The native part of the Python package `tidemap`: a client of the daemon, and models in process.
//!
//! Python sees plain functions and numpy arrays; the sources in `python/tidemap` give them their names and types.
//! Invariant: the interpreter's lock is free while anything waits or computes, and Ctrl-C ends every wait.

use pyo3::prelude::*;

mod answers;
mod client;
mod failure;
mod grids;
mod models;
mod observe;
mod open_producer;
mod queue;
mod reports;
mod room;
mod rpc;
mod waiting;
mod zones;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<client::NativeClient>()?;
    module.add_class::<open_producer::OpenProducer>()?;
    module.add_class::<queue::NativeQueue>()?;
    module.add_class::<rpc::Replies>()?;
    module.add_class::<models::NativeModel>()?;
    module.add_function(wrap_pyfunction!(rpc::model_request, module)?)?;
    module.add_function(wrap_pyfunction!(models::model_parameters, module)?)?;
    module.add_function(wrap_pyfunction!(answers::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(answers::history, module)?)?;
    module.add_function(wrap_pyfunction!(zones::zone_offsets, module)?)?;
    module.add_function(wrap_pyfunction!(reports::stated_reporting, module)?)?;
    module.add_function(wrap_pyfunction!(reports::duration_nanos, module)?)?;
    module.add_function(wrap_pyfunction!(reports::usual_words, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
