//! Errors as Python's exceptions.
//!
//! Invariant: an exception has the words of the daemon or of the client library, and the code that programs decide by.

use pyo3::prelude::*;
use tidemap_client::{
    Error,
    observe::{ProducerError, QueueError},
};

/// The exception for a code of gRPC, made by `tidemap.errors`.
pub(crate) fn exception(py: Python<'_>, code: &str, message: &str) -> PyErr {
    let made = py.import("tidemap.errors").and_then(|errors| errors.call_method1("of_code", (code, message)));
    match made {
        Ok(exception) => PyErr::from_value(exception),
        Err(error) => error,
    }
}

/// The name of a code of gRPC, such as `NOT_FOUND`.
pub(crate) fn code_name(code: tonic::Code) -> String {
    let name = format!("{code:?}");
    let mut spelt = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && !spelt.is_empty() {
            spelt.push('_');
        }
        spelt.push(letter.to_ascii_uppercase());
    }
    spelt
}

/// A wrong argument.
pub(crate) fn invalid(py: Python<'_>, message: &str) -> PyErr {
    exception(py, "INVALID_ARGUMENT", message)
}

/// An error of a request.
pub(crate) fn request(py: Python<'_>, error: &Error) -> PyErr {
    let code = match error {
        Error::Server(refused) => code_name(refused.code),
        Error::Unreachable { .. } => "UNAVAILABLE".to_owned(),
        Error::ClientCertificate { .. } => "UNAUTHENTICATED".to_owned(),
        Error::Protocol(_) => "INTERNAL".to_owned(),
        _ => "INVALID_ARGUMENT".to_owned(),
    };
    exception(py, &code, &error.to_string())
}

/// Why observations could not all be sent.
pub(crate) fn producer(py: Python<'_>, error: &ProducerError) -> PyErr {
    let code = match error {
        ProducerError::GaveUp { .. } => "UNAVAILABLE",
        ProducerError::Superseded(_) | ProducerError::KeyInUse(_) => "ALREADY_EXISTS",
        ProducerError::MapNotFound(_) | ProducerError::MapDeleted(_) => "NOT_FOUND",
        ProducerError::Exhausted(_) => "RESOURCE_EXHAUSTED",
        ProducerError::DataMismatch(_)
        | ProducerError::Foreign { .. }
        | ProducerError::Differs { .. }
        | ProducerError::Lost { .. } => "FAILED_PRECONDITION",
        ProducerError::Other(error) => return request(py, error),
        ProducerError::Storage(_) => "UNAVAILABLE",
        _ => "INVALID_ARGUMENT",
    };
    exception(py, code, &error.to_string())
}

/// Why the queue did not take an observation, or cannot be used.
pub(crate) fn queue(py: Python<'_>, error: &QueueError) -> PyErr {
    let code = match error {
        QueueError::Full { .. } => "RESOURCE_EXHAUSTED",
        QueueError::InUse { .. } => "ALREADY_EXISTS",
        QueueError::OtherStream { .. } | QueueError::Closed => "FAILED_PRECONDITION",
        QueueError::Damaged { .. } => "DATA_LOSS",
        QueueError::StillWaiting { .. } => "UNAVAILABLE",
        QueueError::Occupancy(_) => "INVALID_ARGUMENT",
        QueueError::Producer(error) => return producer(py, error),
        QueueError::Unreachable(error) | QueueError::Map(error) => return request(py, error),
        _ => "INTERNAL",
    };
    exception(py, code, &error.to_string())
}
