//! Errors of requests to the daemon.
//!
//! Invariant: the variant and the status code of an error determine how to handle it, never the text; messages are for
//! people and are passed on complete.

use std::{error::Error as StdError, io, time::Duration};

use tonic::{Code, Status};
use tonic_types::StatusExt as _;

/// Why a request failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum Error {
    #[error("{url:?} is not an address of a daemon: use HOST:PORT, http://HOST:PORT or https://HOST:PORT{hint}")]
    Address { url: String, hint: &'static str },
    #[error("the token holds characters that cannot be sent: use printable ASCII on one line")]
    Token,
    #[error("a token is not sent to {server} without TLS, because others could read it: use an https:// address")]
    TokenInClear { server: String },
    #[error("TLS: {0}")]
    Tls(String),
    #[error("no daemon responds at {server}: {detail}")]
    Unreachable { server: String, detail: String },
    /// The daemon ended the handshake of TLS because this client's certificate is wrong or missing.
    #[error("the daemon at {server} {problem}")]
    ClientCertificate { server: String, problem: String },
    /// The daemon refused the request, or failed.
    #[error("{0}")]
    Server(ServerError),
    #[error("the reply of the daemon is invalid: {0}; does it have another version?")]
    Protocol(&'static str),
}

/// An error reply of the daemon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}{}", shown_fields(message, fields))]
pub struct ServerError {
    /// The status code, for programs.
    pub code: Code,
    /// The message, for people.
    pub message: String,
    /// The invalid fields of the request.
    pub fields: Vec<WrongField>,
    /// The daemon had no room, and did nothing: the same request may be sent again after this time.
    pub retry_after: Option<Duration>,
}

/// An invalid field of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrongField {
    /// Path, for example `periodicities.harmonics.count`.
    pub field: String,
    /// Why it is invalid.
    pub description: String,
}

/// The fields whose description is not part of the message.
fn shown_fields(message: &str, fields: &[WrongField]) -> String {
    fields
        .iter()
        .filter(|wrong| !message.contains(&wrong.description))
        .map(|wrong| format!("; {}: {}", wrong.field, wrong.description))
        .collect()
}

impl Error {
    /// Converts a status from `server`, or from the connection to it.
    pub(crate) fn from_status(server: &str, status: &Status) -> Self {
        match transport_cause(status) {
            Some(detail) => match certificate_problem(&detail) {
                Some(problem) => Self::ClientCertificate { server: server.to_owned(), problem },
                None => Self::Unreachable { server: server.to_owned(), detail },
            },
            None => Self::Server(ServerError::from_status(status)),
        }
    }

    /// Whether the same request may succeed later.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        match self {
            // Another certificate may be in place by then, on either side.
            Self::Unreachable { .. } | Self::ClientCertificate { .. } => true,
            Self::Server(error) => error.is_transient(),
            Self::Address { .. } | Self::Token | Self::TokenInClear { .. } | Self::Tls(_) | Self::Protocol(_) => false,
        }
    }

    /// The time after which the same request may be sent again, if the daemon had no room for it and did nothing.
    #[must_use]
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Server(error) => error.retry_after,
            _ => None,
        }
    }

    /// The status code, if the daemon replied with one.
    #[must_use]
    pub fn code(&self) -> Option<Code> {
        match self {
            Self::Server(error) => Some(error.code),
            _ => None,
        }
    }
}

impl ServerError {
    /// An error of a stream, which has no further details.
    pub(crate) fn new(code: Code, message: String) -> Self {
        Self { code, message, fields: Vec::new(), retry_after: None }
    }

    fn from_status(status: &Status) -> Self {
        let fields = status.get_details_bad_request().map_or_else(Vec::new, |bad| {
            let wrong = |violation: tonic_types::FieldViolation| WrongField {
                field: violation.field,
                description: violation.description,
            };
            bad.field_violations.into_iter().map(wrong).collect()
        });
        let message =
            if status.message().is_empty() { status.code().description() } else { status.message() }.to_owned();
        Self { code: status.code(), message, fields, retry_after: retry_after(status) }
    }

    /// Whether the same request may succeed later. A connection that breaks during a request arrives as one of several
    /// codes, depending on the layer that noticed it.
    fn is_transient(&self) -> bool {
        matches!(
            self.code,
            Code::Unavailable | Code::Unknown | Code::Internal | Code::Cancelled | Code::DeadlineExceeded
        )
    }
}

/// The time after which a request that found no room may be sent again, as stated by the daemon or by a proxy in front
/// of it.
#[must_use]
pub fn retry_after(status: &Status) -> Option<Duration> {
    if status.code() != Code::ResourceExhausted {
        return None;
    }
    let in_details = status.get_details_retry_info().and_then(|info| info.retry_delay);
    in_details.or_else(|| {
        let header = status.metadata().get("retry-after")?.to_str().ok()?;
        header.trim().parse().ok().map(Duration::from_secs)
    })
}

/// The innermost cause, if this side made the status because the connection failed.
fn transport_cause(status: &Status) -> Option<String> {
    status.source().map(root_cause)
}

/// The problem with the client's certificate that the TLS alert in a cause names. HTTP/2 passes the alert on as text
/// only.
fn certificate_problem(cause: &str) -> Option<String> {
    let alert = cause.split("received fatal alert: ").nth(1)?;
    let alert: String = alert.chars().take_while(char::is_ascii_alphanumeric).collect();
    let refused = ["BadCertificate", "UnknownCA", "CertificateExpired", "CertificateUnknown", "CertificateRevoked"];
    match alert.as_str() {
        "CertificateRequired" => Some(
            "requires a certificate of the client: name it and its private key (--tls-cert FILE and --tls-key FILE, or \
             TIDEMAP_TLS_CERT and TIDEMAP_TLS_KEY)"
                .to_owned(),
        ),
        _ if refused.contains(&alert.as_str()) => Some(format!(
            "does not accept the certificate of the client ({alert}): it must be valid now, and one of an authority \
             that the daemon's setting tls_client_ca names"
        )),
        _ => None,
    }
}

/// The text of the innermost cause.
pub(crate) fn root_cause(error: &(dyn StdError + 'static)) -> String {
    let mut cause = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    match cause.downcast_ref::<io::Error>() {
        Some(error) if error.kind() == io::ErrorKind::ConnectionRefused => "connection refused".to_owned(),
        _ => cause.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn a_status_keeps_its_code_message_and_fields() {
        let details = ErrorDetails::with_bad_request_violation("time_zone", "\"Mars/Base\" is not an IANA time zone");
        let status = Status::with_error_details(Code::InvalidArgument, "invalid map", details);
        let error = Error::from_status("http://h:1", &status);
        assert_eq!(error.code(), Some(Code::InvalidArgument));
        assert_eq!(error.to_string(), "invalid map; time_zone: \"Mars/Base\" is not an IANA time zone");
        assert!(!error.is_transient());
    }

    #[test]
    fn a_field_that_the_message_names_is_not_named_twice() {
        let details = ErrorDetails::with_bad_request_violation("name", "too long");
        let status = Status::with_error_details(Code::InvalidArgument, "name: too long", details);
        assert_eq!(Error::from_status("http://h:1", &status).to_string(), "name: too long");
    }

    #[test]
    fn the_time_of_another_try_is_that_of_the_daemon() {
        let hint = |details, header: Option<&str>| {
            let mut status = Status::with_error_details(Code::ResourceExhausted, "full", details);
            if let Some(header) = header {
                status.metadata_mut().insert("retry-after", header.parse().expect("text"));
            }
            Error::from_status("http://h:1", &status).retry_after()
        };
        let in_details = ErrorDetails::with_retry_info(Some(Duration::from_millis(250)));
        assert_eq!(hint(in_details, None), Some(Duration::from_millis(250)));
        assert_eq!(hint(ErrorDetails::new(), Some("3")), Some(Duration::from_secs(3)));
        assert_eq!(hint(ErrorDetails::new(), None), None, "too much for a limit, at any time");
        assert_eq!(retry_after(&Status::unavailable("no")), None);
    }

    #[test]
    fn an_alert_about_the_certificate_contains_advice() {
        for (alert, words) in [("CertificateRequired", "--tls-cert"), ("CertificateExpired", "valid now")] {
            let cause = io::Error::other(format!("received fatal alert: {alert}"));
            let error = Error::from_status("https://h:1", &Status::from_error(Box::new(cause)));
            assert!(matches!(error, Error::ClientCertificate { .. }) && error.is_transient(), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
        let cause = io::Error::other("received fatal alert: HandshakeFailure");
        let error = Error::from_status("https://h:1", &Status::from_error(Box::new(cause)));
        assert!(matches!(error, Error::Unreachable { .. }), "{error}");
    }

    #[test]
    fn a_broken_connection_is_not_an_answer() {
        let refused = io::Error::new(io::ErrorKind::ConnectionRefused, "os error 111");
        let status = Status::from_error(Box::new(refused));
        let error = Error::from_status("http://h:1", &status);
        assert_eq!(error.to_string(), "no daemon responds at http://h:1: connection refused");
        assert!(error.is_transient());
    }
}
