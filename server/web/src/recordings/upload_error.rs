//! Errors of recordings that are not taken.
//!
//! Invariant: each message states what to do. An error of an RPC has the same response as from the RPC.

use std::{io, path::PathBuf};

use axum::{http::StatusCode, response::Response};
use tidemap_map::name::{InvalidName, MapName};
use tidemap_rpc::status::RpcError;
use tonic::Status;

use super::{
    super::{json, links::Failure},
    turns::NoTurn,
};

/// The reason why a recording is not taken.
#[derive(Debug, thiserror::Error)]
pub(super) enum UploadError {
    #[error("{0}")]
    Rpc(Box<RpcError>),
    #[error("{}", .0.message())]
    Status(Box<Status>),
    #[error("the parameters of the address are wrong")]
    Parameters(Box<Failure>),
    #[error("parameter bytes is the size of the file, a number of bytes")]
    Bytes,
    #[error("parameter update is true or false")]
    Update,
    #[error("map {map} does not exist, and this sender may not create it: {error}")]
    NotCreated { map: MapName, error: Box<RpcError> },
    #[error("this daemon accepts no recordings over HTTP (setting max_upload_bytes is 0): use tidemap import")]
    Off,
    #[error(
        "this daemon cannot read recordings, because the program tidemap is not beside it, at {}: use tidemap import",
        .0.display()
    )]
    NoProgram(PathBuf),
    #[error(transparent)]
    Name(#[from] InvalidName),
    #[error("{0:?} is no name of a file: name the recording as it is called on its disk, such as drive.mcap")]
    FileName(String),
    #[error("the name of the file has {bytes} bytes, and at most {max} are allowed: send it under a shorter name")]
    LongName { bytes: usize, max: usize },
    #[error("send the file as application/octet-stream")]
    MediaType,
    #[error(transparent)]
    NoTurn(#[from] NoTurn),
    #[error(
        "the file has more than {max} bytes, which is the maximum (setting max_upload_bytes): use tidemap import, or \
         split the recording"
    )]
    TooLarge { max: u64 },
    #[error("the file has no bytes")]
    Empty,
    #[error(
        "there is no room for the file: the disk of the data folder has {free} bytes left, of which {kept} are \
         kept for maps. Use tidemap import, which needs no copy"
    )]
    NoRoom { free: u64, kept: u64 },
    #[error("nothing more of the file arrived for {secs} seconds: send it again")]
    Late { secs: u64 },
    #[error(
        "the file arrives too slowly: it needs {kib_per_sec} KiB a second. Use tidemap import, which can continue later"
    )]
    Slow { kib_per_sec: u64 },
    #[error("the file has not arrived within {hours} hours: use tidemap import, or split the recording")]
    Long { hours: u64 },
    #[error("the file broke off: send it again")]
    Broken,
    #[error("the daemon is stopping; send the file again later")]
    Stopping,
    #[error("the file cannot be kept until it is imported: {0}")]
    Disk(#[from] io::Error),
}

impl From<RpcError> for UploadError {
    fn from(error: RpcError) -> Self {
        Self::Rpc(Box::new(error))
    }
}

impl From<Failure> for UploadError {
    fn from(failure: Failure) -> Self {
        Self::Parameters(Box::new(failure))
    }
}

impl UploadError {
    /// The response for this error.
    pub(super) fn response(self) -> Response {
        let text = self.to_string();
        let (http, code, reason) = match self {
            Self::Rpc(error) => return json::status_reply(&(*error).into()),
            Self::Status(status) => return json::status_reply(&status),
            Self::Parameters(failure) => return failure.response(),
            Self::NotCreated { .. } => (StatusCode::FORBIDDEN, "PERMISSION_DENIED", "NEEDS_ROLE"),
            Self::Off => (StatusCode::NOT_IMPLEMENTED, "UNIMPLEMENTED", "UPLOADS_OFF"),
            Self::NoProgram(_) => (StatusCode::NOT_IMPLEMENTED, "UNIMPLEMENTED", "NO_PROGRAM"),
            Self::Bytes | Self::Update | Self::Name(_) | Self::FileName(_) | Self::LongName { .. } => {
                (StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "INVALID_FIELD")
            }
            Self::Empty => (StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "EMPTY"),
            Self::Broken => (StatusCode::BAD_REQUEST, "INVALID_ARGUMENT", "BROKEN"),
            Self::MediaType => (StatusCode::UNSUPPORTED_MEDIA_TYPE, "INVALID_ARGUMENT", "MEDIA_TYPE"),
            Self::NoTurn(NoTurn::Memory(_)) => (StatusCode::SERVICE_UNAVAILABLE, "RESOURCE_EXHAUSTED", "NO_MEMORY"),
            Self::NoTurn(_) => (StatusCode::TOO_MANY_REQUESTS, "RESOURCE_EXHAUSTED", "BUSY"),
            Self::TooLarge { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "RESOURCE_EXHAUSTED", "LIMIT"),
            Self::NoRoom { .. } => (StatusCode::INSUFFICIENT_STORAGE, "RESOURCE_EXHAUSTED", "DISK_FULL"),
            Self::Late { .. } | Self::Slow { .. } | Self::Long { .. } => {
                (StatusCode::REQUEST_TIMEOUT, "DEADLINE_EXCEEDED", "LATE")
            }
            Self::Stopping => (StatusCode::SERVICE_UNAVAILABLE, "UNAVAILABLE", "STOPPING"),
            Self::Disk(_) => (StatusCode::INTERNAL_SERVER_ERROR, "INTERNAL", "STORAGE_FAILED"),
        };
        json::failure(http, code, reason, &text)
    }
}
