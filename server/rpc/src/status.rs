//! Errors as gRPC statuses with `google.rpc` details: the only place where a status is made.
//!
//! Invariant: the message states what is wrong, with which value, and what to do; programs read code and details.

use std::{collections::HashMap, time::Duration};

use tidemap_answer::{ModelSubject, ModelUnavailable};
use tidemap_base::{
    access::{Role, keyring::Denial},
    shares::ShareFull,
    task::NoResult,
};
use tidemap_grid::{sensors::InvalidSensor, tile::TileUnavailable};
use tidemap_ingest::{
    backups::TargetError,
    catalog::CatalogError,
    cluster::{ClusterError, operations::OperationError},
    ending::{Ending, is_fatal},
    intake::IntakeError,
    protocol::{AddStateError, EditSiteError, ForgetError, HelloError},
    role::NotWriter,
};
use tidemap_map::{event::StateShape, no_go::NoGoError, site::InvalidEdit, task::TaskError};
use tidemap_model::EarlyStop;
use tidemap_proto::convert::{InvalidField, OverLimit};
use tidemap_store::{AppendError, BackupError, HistoryError};
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt as _};

mod gateway_error;
mod misfit;
mod plan_error;
mod route_error;

pub(crate) use gateway_error::GatewayError;
pub(crate) use misfit::{Misfit, Problem};
pub(crate) use plan_error::PlanError;
pub(crate) use route_error::RouteError;

use route_error::{landmark_refusal, refusal_of};

const DOMAIN: &str = "tidemap";
const NAMES_SHOWN: usize = 10;
/// Time after which a request for which all places were taken may find one.
const RETRY_SOON: Duration = Duration::from_millis(100);
/// Time after which a request that waited for a place in vain may find one.
const RETRY_LATER: Duration = Duration::from_secs(1);
const NO_HELLO: &str = "no Hello within 10 seconds";
/// Number of characters that are kept of the beginning of a message. Its end is kept too, because it states what to do.
const HEAD_CHARS: usize = 1200;
const TAIL_CHARS: usize = 600;

/// All errors that a request can end with.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum RpcError {
    #[error(transparent)]
    Field(#[from] InvalidField),
    #[error(transparent)]
    Misfit(#[from] Misfit),
    #[error("hello: {NO_HELLO}")]
    NoHello,
    #[error("path: {0}")]
    BackupTarget(#[from] TargetError),
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    #[error("map {name:?} does not exist; {}", known_names(.known, "maps"))]
    UnknownMap { name: String, known: Vec<String> },
    #[error("state {name:?} does not exist in map {map:?}; {}", known_names(.known, "states"))]
    UnknownState { map: String, name: String, known: Vec<String> },
    #[error("state {name:?} of map {map:?} is {}: use its parts, {}", .shape.with_article(), .axes.join(", "))]
    IsVector { map: String, name: String, shape: StateShape, axes: Vec<String> },
    #[error("map {map:?} has no grid: a map gets one when it is created")]
    NoGrid { map: String },
    #[error("{name} of map {map:?} was never observed")]
    UnknownCell { map: String, name: String },
    #[error(transparent)]
    Tile(#[from] TileUnavailable),
    #[error("map {map:?} keeps no history of {what}: create it with {option}, such as 90d or forever")]
    NoHistory { map: String, what: &'static str, option: &'static str },
    #[error("{subject} in map {map:?}: {reason}")]
    ModelUnavailable { subject: ModelSubject, map: String, reason: ModelUnavailable },
    #[error("{name} of map {map:?}: observations before {} are no longer kept", shown_time(*.kept_from_nanos))]
    BeyondHistory { map: String, name: String, kept_from_nanos: i64 },
    #[error(transparent)]
    Backup(#[from] BackupError),
    #[error(
        "this daemon has no folder for the backups that others request: name an absolute one in its setting \
         backup_dir, and a folder below it in the request"
    )]
    NoBackupFolder,
    #[error(transparent)]
    History(#[from] HistoryError),
    #[error("an update has the observations of that time and has not ended within {0} seconds: try again")]
    Updating(u64),
    #[error(transparent)]
    NotWriter(#[from] NotWriter),
    #[error(transparent)]
    Operation(#[from] OperationError),
    #[error("job {0} is not known: it is long past, or the daemon was restarted since")]
    UnknownJob(u64),
    #[error(
        "job {0} has no report: it has not ended successfully, a later update of the same map replaced it, or something was \
         erased from the map since"
    )]
    NoReport(u64),
    #[error(transparent)]
    Limit(#[from] OverLimit),
    #[error(transparent)]
    AddState(#[from] AddStateError),
    #[error(transparent)]
    Forget(#[from] ForgetError),
    #[error(transparent)]
    EditSite(#[from] EditSiteError),
    #[error(transparent)]
    Plan(#[from] PlanError),
    #[error(transparent)]
    Route(#[from] RouteError),
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    #[error(transparent)]
    Hello(#[from] HelloError),
    #[error(transparent)]
    Intake(#[from] IntakeError),
    #[error("{}", ending_text(.0))]
    Ended(Ending),
    #[error(
        "{max} requests for predictions are running, which is the maximum, and none ended within {secs} seconds: try again"
    )]
    Busy { max: usize, secs: u64 },
    #[error(
        "{waiting} requests of this kind wait already, and this one would wait for about {} ms: try again later",
        .wait.as_millis()
    )]
    Overloaded { waiting: usize, wait: Duration },
    #[error(transparent)]
    Share(#[from] ShareFull),
    #[error("the request, or more of it, did not arrive within {secs} seconds")]
    Late { secs: u64 },
    #[error("the stream's replies were not read for {0} seconds")]
    SlowReader(u64),
    #[error("the connection broke")]
    Broken,
    #[error(
        "the stream was silent for {} seconds or more and made room for another one (settings max_streams and \
         stream_idle_secs): connect again to send more", .0.as_secs()
    )]
    Idle(Duration),
    #[error(
        "all places of streams are in use (setting max_streams), and this map had most of them: the stream made room for \
         one of another map. Connect again when some have ended"
    )]
    Crowded,
    /// Nobody receives this error.
    #[error(transparent)]
    Left(#[from] EarlyStop),
    #[error("map {map:?} is being opened: {done} of {total} records of its log are replayed; try again")]
    Opening { map: String, done: u64, total: u64 },
    #[error("the daemon is stopping; connect again later")]
    Stopping,
    #[error("{}", match .0 {
        Denial::Missing => "this daemon requires a token: send `authorization: Bearer TOKEN` (tidemap --token-file, Python token=)",
        Denial::Unknown => "the token is not valid here, or was revoked",
        Denial::Expired => "the token has expired: ask an admin for a new one (tidemapd token create)",
    })]
    Denial(Denial),
    #[error("the token was revoked or changed, or has expired")]
    Revoked,
    #[error("{method} needs role {}, which the token does not have", .role.name())]
    NeedsRole { method: String, role: Role },
    #[error("{method} changes data; over HTTP that needs tokens, or setting http_write (tidemapd --http-write)")]
    ReadOnly { method: String },
    #[error("map {map:?} does not exist, or the token is not for it")]
    NotForMap { map: String },
    #[error(
        "the token may not send as producer {producer:?}: `tidemapd token list` shows the producers that it is for"
    )]
    NotForProducer { producer: String },
    #[error("this needs a token for all maps")]
    NeedsAllMaps,
    #[error("this daemon has no such method; does it have another version?")]
    UnknownMethod,
}

fn known_names(known: &[String], what: &str) -> String {
    if known.is_empty() {
        return format!("there are no {what} yet");
    }
    let shown = known.iter().take(NAMES_SHOWN).cloned().collect::<Vec<_>>().join(", ");
    let more = if known.len() > NAMES_SHOWN { ", …" } else { "" };
    format!("{what} here: {shown}{more}")
}

/// A text with at most [`HEAD_CHARS`] and [`TAIL_CHARS`] characters.
fn shortened(text: String) -> String {
    let chars = text.chars().count();
    if chars <= HEAD_CHARS + TAIL_CHARS {
        return text;
    }
    let head: String = text.chars().take(HEAD_CHARS).collect();
    let tail: String = text.chars().skip(chars - TAIL_CHARS).collect();
    format!("{head} … {tail}")
}

/// Formats a time as seconds since 1970, because the client chooses the time zone.
fn shown_time(nanos: i64) -> String {
    format!("{} s after 1970-01-01T00:00:00Z", nanos.div_euclid(1_000_000_000))
}

fn ending_text(ending: &Ending) -> String {
    match ending {
        Ending::Shutdown => "the daemon is stopping; connect again later".to_owned(),
        Ending::Erasure => "something is being erased from the map; connect again".to_owned(),
        Ending::Superseded => "another stream of the same producer and label took over".to_owned(),
        Ending::Unanswered => "another stream of the same producer and label took over, because this one did not \
                               respond to a probe within two seconds"
            .to_owned(),
        Ending::MapDeleted => "the map was deleted".to_owned(),
        Ending::Moved { writer: None } => "another daemon writes the map; connect again".to_owned(),
        Ending::Moved { writer: Some(writer) } => format!("{writer} writes the map; connect again"),
        Ending::Replaced => "a copy of another daemon's map replaces the map; connect again".to_owned(),
        Ending::Forked { .. } => {
            "the log of the map and the one that daemons share differ: this daemon does not serve \
                                  the map; connect to another"
                .to_owned()
        }
        Ending::Storage(error) => error.to_string(),
    }
}

fn append_code(error: &AppendError) -> (Code, &'static str) {
    match error {
        AppendError::NotWriter { .. } => (Code::Unavailable, "NOT_WRITER"),
        error if is_fatal(error) => (Code::Unavailable, "STORAGE_FAILED"),
        _ => (Code::ResourceExhausted, "DISK_FULL"),
    }
}

fn operation_code(error: &OperationError) -> (Code, &'static str) {
    match error {
        OperationError::NoCluster => (Code::FailedPrecondition, "NO_CLUSTER"),
        OperationError::UnknownMap(_) => (Code::NotFound, "UNKNOWN_MAP"),
        OperationError::UnknownMember { .. } => (Code::NotFound, "UNKNOWN_MEMBER"),
        OperationError::UnknownFork { .. } => (Code::NotFound, "UNKNOWN_FORK"),
        OperationError::NotHeld(_) => (Code::FailedPrecondition, "NOT_HELD"),
        OperationError::Gone(_) => (Code::FailedPrecondition, "MEMBER_GONE"),
        OperationError::Alive(_) => (Code::FailedPrecondition, "MEMBER_ALIVE"),
        OperationError::Draining(_) => (Code::FailedPrecondition, "MEMBER_DRAINS"),
        OperationError::NoCapacity(_) | OperationError::DoesNotHold { .. } => (Code::FailedPrecondition, "NOT_HELD"),
        OperationError::Changed(_) => (Code::Aborted, "CHANGED"),
        OperationError::Engine(_) => (Code::Unavailable, "ENGINE_UNAVAILABLE"),
        OperationError::NotAligned(_) => (Code::Unavailable, "NOT_ALIGNED"),
        OperationError::Log(_) | OperationError::Copy(_) => (Code::DataLoss, "STORAGE_FAILED"),
    }
}

/// The name of a code, as gRPC writes it.
pub fn code_name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

impl From<NoResult> for RpcError {
    fn from(_: NoResult) -> Self {
        Self::Stopping
    }
}

impl RpcError {
    pub(super) fn code_and_reason(&self) -> (Code, &'static str) {
        match self {
            Self::Field(_)
            | Self::Misfit(_)
            | Self::NoHello
            | Self::BackupTarget(_)
            | Self::Intake(IntakeError::Invalid(_)) => (Code::InvalidArgument, "INVALID_FIELD"),
            Self::Catalog(error) => match error {
                CatalogError::Exists(_) => (Code::AlreadyExists, "MAP_EXISTS"),
                CatalogError::Unknown(_) => (Code::NotFound, "UNKNOWN_MAP"),
                CatalogError::TooMany { .. } => (Code::ResourceExhausted, "LIMIT"),
                CatalogError::Store(_) | CatalogError::Copy(_) | CatalogError::NoCopyNeeded(_) => {
                    (Code::Internal, "STORAGE_FAILED")
                }
                CatalogError::Unavailable { .. } => (Code::DataLoss, "MAP_UNAVAILABLE"),
                CatalogError::Open(error) if error.is_shortage() => (Code::Unavailable, "SHORTAGE"),
                CatalogError::Open(_)
                | CatalogError::Inconsistent { .. }
                | CatalogError::Sums { .. }
                | CatalogError::Forked { .. }
                | CatalogError::Duplicate { .. } => (Code::DataLoss, "STORAGE_FAILED"),
                CatalogError::Thread(_) => (Code::ResourceExhausted, "LIMIT"),
                CatalogError::NoProducer { .. } => (Code::NotFound, "UNKNOWN_PRODUCER"),
                CatalogError::Erase(_) => (Code::Internal, "STORAGE_FAILED"),
                CatalogError::NoState { .. } => (Code::NotFound, "UNKNOWN_STATE"),
                CatalogError::Axis { .. } => (Code::InvalidArgument, "IS_VECTOR"),
                CatalogError::Stopping => (Code::Unavailable, "STOPPING"),
                CatalogError::Cluster(ClusterError::Exists(_)) => (Code::AlreadyExists, "MAP_EXISTS"),
                CatalogError::Cluster(_) => (Code::Unavailable, "ENGINE_UNAVAILABLE"),
                CatalogError::NoCluster(_) => (Code::FailedPrecondition, "NO_CLUSTER"),
                CatalogError::NotErasedInCluster(_) => (Code::Unimplemented, "NOT_IN_CLUSTER"),
            },
            Self::UnknownMap { .. } => (Code::NotFound, "UNKNOWN_MAP"),
            Self::UnknownState { .. } => (Code::NotFound, "UNKNOWN_STATE"),
            Self::IsVector { .. } => (Code::InvalidArgument, "IS_VECTOR"),
            Self::NoGrid { .. } => (Code::FailedPrecondition, "NO_GRID"),
            Self::UnknownCell { .. } => (Code::NotFound, "UNKNOWN_CELL"),
            Self::Tile(_) => (Code::Internal, "STORAGE_FAILED"),
            Self::NoHistory { .. } => (Code::FailedPrecondition, "NO_HISTORY"),
            Self::ModelUnavailable { reason, .. } => match reason {
                ModelUnavailable::NotKept { .. } | ModelUnavailable::Forgotten => {
                    (Code::FailedPrecondition, "NO_HISTORY")
                }
                ModelUnavailable::TooMany { .. } => (Code::ResourceExhausted, "LIMIT"),
                ModelUnavailable::RasterTooLarge { .. } => (Code::InvalidArgument, "INVALID_ARGUMENT"),
                ModelUnavailable::OtherKind { .. }
                | ModelUnavailable::StatesOnly
                | ModelUnavailable::CannotTrain(_)
                | ModelUnavailable::NoPlaces
                | ModelUnavailable::NoneInRegion { .. }
                | ModelUnavailable::NobodyMoves
                | ModelUnavailable::Unlearned => (Code::FailedPrecondition, "MODEL_UNAVAILABLE"),
            },
            Self::BeyondHistory { .. } => (Code::OutOfRange, "BEYOND_HISTORY"),
            Self::Backup(error) => match error {
                BackupError::NotEmpty(_) | BackupError::Inside(_) | BackupError::OtherStore(_) => {
                    (Code::FailedPrecondition, "BACKUP_FOLDER")
                }
                BackupError::Stopped => (Code::Unavailable, "STOPPING"),
                error if error.is_disk_full() => (Code::ResourceExhausted, "DISK_FULL"),
                _ => (Code::Internal, "STORAGE_FAILED"),
            },
            Self::NoBackupFolder => (Code::FailedPrecondition, "BACKUP_FOLDER"),
            Self::History(error) => match error {
                HistoryError::UnknownMap(_) => (Code::NotFound, "MAP_DELETED"),
                HistoryError::Damaged { .. } => (Code::DataLoss, "STORAGE_FAILED"),
                HistoryError::Missing { .. } => (Code::DataLoss, "HISTORY_MISSING"),
                HistoryError::Io { .. } if error.is_shortage() => (Code::Unavailable, "SHORTAGE"),
                HistoryError::Io { .. } => (Code::Internal, "STORAGE_FAILED"),
            },
            Self::Updating(_) => (Code::Unavailable, "UPDATING"),
            Self::NotWriter(_) => (Code::Unavailable, "NOT_WRITER"),
            Self::Operation(error) => operation_code(error),
            Self::UnknownJob(_) => (Code::NotFound, "UNKNOWN_JOB"),
            Self::NoReport(_) => (Code::FailedPrecondition, "NO_REPORT"),
            Self::Limit(_) | Self::Busy { .. } | Self::Overloaded { .. } | Self::Intake(IntakeError::Limit(_)) => {
                (Code::ResourceExhausted, "LIMIT")
            }
            Self::AddState(error) => match error {
                AddStateError::OtherKind { .. }
                | AddStateError::OtherSensor { .. }
                | AddStateError::OtherLabels { .. }
                | AddStateError::OtherReporting { .. } => (Code::AlreadyExists, "STATE_EXISTS"),
                AddStateError::NoRoom(_) => (Code::ResourceExhausted, "LIMIT"),
                AddStateError::NotWriter(_) => (Code::Unavailable, "NOT_WRITER"),
                AddStateError::Storage(error) => append_code(error),
                AddStateError::Closing => (Code::Unavailable, "STOPPING"),
            },
            Self::Forget(error) => match error {
                ForgetError::Unknown { .. } => (Code::NotFound, "UNKNOWN_PRODUCER"),
                ForgetError::Streaming { .. } => (Code::FailedPrecondition, "STREAMING"),
                ForgetError::TooMany { .. } => (Code::ResourceExhausted, "LIMIT"),
                ForgetError::NotWriter(_) => (Code::Unavailable, "NOT_WRITER"),
                ForgetError::Storage(error) => append_code(error),
                ForgetError::Closing => (Code::Unavailable, "STOPPING"),
            },
            Self::EditSite(error) => match error {
                EditSiteError::Invalid(InvalidEdit::UnknownLocation(_)) => (Code::NotFound, "UNKNOWN_LOCATION"),
                EditSiteError::Invalid(InvalidEdit::TooManyLocations(_) | InvalidEdit::TooManyStates { .. }) => {
                    (Code::ResourceExhausted, "LIMIT")
                }
                EditSiteError::Invalid(InvalidEdit::Task(TaskError::Unknown(_))) => (Code::NotFound, "UNKNOWN_TASK"),
                EditSiteError::Invalid(InvalidEdit::Task(TaskError::TooMany(_))) => (Code::ResourceExhausted, "LIMIT"),
                EditSiteError::Invalid(InvalidEdit::NoGo(NoGoError::Unknown(_))) => (Code::NotFound, "UNKNOWN_AREA"),
                EditSiteError::Invalid(InvalidEdit::NoGo(NoGoError::TooMany)) => (Code::ResourceExhausted, "LIMIT"),
                EditSiteError::Invalid(InvalidEdit::Topology(error)) => refusal_of(error),
                EditSiteError::Invalid(InvalidEdit::Landmarks(error)) => landmark_refusal(error),
                EditSiteError::Invalid(InvalidEdit::StateExists { .. }) => (Code::AlreadyExists, "STATE_EXISTS"),
                EditSiteError::Invalid(_) => (Code::InvalidArgument, "INVALID_FIELD"),
                EditSiteError::NotWriter(_) => (Code::Unavailable, "NOT_WRITER"),
                EditSiteError::Storage(error) => append_code(error),
                EditSiteError::Closing => (Code::Unavailable, "STOPPING"),
            },
            Self::Plan(error) => error.code_and_reason(),
            Self::Route(error) => error.code_and_reason(),
            Self::Gateway(error) => error.code_and_reason(),
            Self::Hello(error) => match error {
                HelloError::AlreadyStreaming { .. } => (Code::AlreadyExists, "ALREADY_STREAMING"),
                HelloError::Fenced { .. } => (Code::Aborted, "FENCED"),
                HelloError::TooManyProducers { .. } | HelloError::TooManyOfClient { .. } => {
                    (Code::ResourceExhausted, "LIMIT")
                }
                HelloError::Forgotten { .. } => (Code::Aborted, "FORGOTTEN"),
                HelloError::Sensor(InvalidSensor::Range(_)) => (Code::InvalidArgument, "INVALID_FIELD"),
                HelloError::Sensor(InvalidSensor::TooMany) => (Code::ResourceExhausted, "LIMIT"),
                HelloError::Sensor(InvalidSensor::Own { .. }) => (Code::FailedPrecondition, "SENSOR"),
                HelloError::SensorWithoutGrid => (Code::FailedPrecondition, "NO_GRID"),
                HelloError::OtherSensor { .. } => (Code::FailedPrecondition, "OTHER_SENSOR"),
                HelloError::NotWriter(_) => (Code::Unavailable, "NOT_WRITER"),
                HelloError::Storage(error) => append_code(error),
                HelloError::Closing => (Code::Unavailable, "STOPPING"),
            },
            Self::Intake(IntakeError::OutOfSequence { .. }) => (Code::OutOfRange, "OUT_OF_SEQUENCE"),
            Self::Intake(IntakeError::DataMismatch { .. }) => (Code::FailedPrecondition, "DATA_MISMATCH"),
            Self::Ended(ending) => match ending {
                Ending::Shutdown => (Code::Unavailable, "STOPPING"),
                Ending::Erasure => (Code::Unavailable, "ERASING"),
                Ending::Superseded | Ending::Unanswered => (Code::Aborted, "SUPERSEDED"),
                Ending::MapDeleted => (Code::NotFound, "MAP_DELETED"),
                Ending::Moved { .. } | Ending::Replaced => (Code::Unavailable, "NOT_WRITER"),
                Ending::Forked { .. } => (Code::Unavailable, "FORKED"),
                Ending::Storage(error) => append_code(error),
            },
            Self::Share(_) => (Code::ResourceExhausted, "LIMIT"),
            Self::Late { .. } => (Code::DeadlineExceeded, "LATE"),
            Self::SlowReader(_) => (Code::ResourceExhausted, "SLOW_READER"),
            Self::Broken => (Code::Cancelled, "BROKEN"),
            Self::Idle(_) => (Code::Unavailable, "IDLE"),
            // Clients connect again by themselves.
            Self::Crowded => (Code::Unavailable, "LIMIT"),
            Self::Left(_) => (Code::Cancelled, "LEFT"),
            Self::Opening { .. } => (Code::Unavailable, "OPENING"),
            Self::Stopping => (Code::Unavailable, "STOPPING"),
            Self::Denial(Denial::Missing) => (Code::Unauthenticated, "NO_TOKEN"),
            Self::Denial(Denial::Unknown) => (Code::Unauthenticated, "UNKNOWN_TOKEN"),
            Self::Denial(Denial::Expired) => (Code::Unauthenticated, "EXPIRED_TOKEN"),
            Self::Revoked => (Code::Unauthenticated, "REVOKED"),
            Self::NeedsRole { .. } => (Code::PermissionDenied, "NEEDS_ROLE"),
            Self::ReadOnly { .. } => (Code::PermissionDenied, "READ_ONLY"),
            Self::NotForMap { .. } => (Code::PermissionDenied, "NOT_FOR_MAP"),
            Self::NotForProducer { .. } => (Code::PermissionDenied, "NOT_FOR_PRODUCER"),
            Self::NeedsAllMaps => (Code::PermissionDenied, "NEEDS_ALL_MAPS"),
            Self::UnknownMethod => (Code::Unimplemented, "UNKNOWN_METHOD"),
        }
    }

    /// The message. A request may have names and values of any length; a message that is too long is cut in its middle.
    pub fn message(&self) -> String {
        shortened(self.to_string())
    }
}

/// The time after which a request that found no room may be sent again; `None`: the same request is refused again.
fn retry_after(error: &RpcError) -> Option<Duration> {
    match error {
        RpcError::Share(full) if full.share.ends_soon() => Some(RETRY_SOON),
        RpcError::Overloaded { wait, .. } => Some(*wait),
        RpcError::Busy { .. } => Some(RETRY_LATER),
        _ => None,
    }
}

impl From<RpcError> for Status {
    fn from(error: RpcError) -> Self {
        let (code, reason) = error.code_and_reason();
        let mut details = ErrorDetails::new();
        let mut metadata = HashMap::new();
        match &error {
            RpcError::Field(field) | RpcError::Intake(IntakeError::Invalid(field)) => {
                details.add_bad_request_violation(shortened(field.field.clone()), shortened(field.description.clone()));
            }
            RpcError::Misfit(Misfit { field, problem }) => {
                details.add_bad_request_violation(shortened(field.clone()), shortened(problem.to_string()));
            }
            RpcError::NoHello => _ = details.add_bad_request_violation("hello", NO_HELLO),
            RpcError::BackupTarget(error) => {
                details.add_bad_request_violation("path", shortened(error.to_string()));
            }
            RpcError::Hello(HelloError::Sensor(invalid @ InvalidSensor::Range(_))) => {
                details.add_bad_request_violation("hello.sensor", invalid.to_string());
            }
            RpcError::UnknownMap { name, .. } => {
                details.set_resource_info("map", shortened(name.clone()), "", error.message());
            }
            RpcError::UnknownState { name, .. } | RpcError::UnknownCell { name, .. } => {
                details.set_resource_info("state", shortened(name.clone()), "", error.message());
            }
            RpcError::Limit(limit) | RpcError::Intake(IntakeError::Limit(limit)) => {
                details.add_quota_failure_violation(limit.what, error.message());
            }
            RpcError::Share(full) => _ = details.add_quota_failure_violation(full.name, error.message()),
            RpcError::History(HistoryError::Missing { from_nanos, to_nanos, .. }) => {
                metadata.insert("from_nanos".to_owned(), from_nanos.to_string());
                metadata.insert("to_nanos".to_owned(), to_nanos.to_string());
            }
            RpcError::Intake(IntakeError::OutOfSequence { got, expected }) => {
                metadata.insert("got".to_owned(), got.to_string());
                metadata.insert("expected".to_owned(), expected.to_string());
            }
            RpcError::Intake(IntakeError::DataMismatch { first, last, .. }) => {
                metadata.insert("first".to_owned(), first.to_string());
                metadata.insert("last".to_owned(), last.to_string());
            }
            _ => {}
        }
        if let Some(wait) = retry_after(&error) {
            details.set_retry_info(Some(wait));
        }
        details.set_error_info(reason, DOMAIN, metadata);
        Status::with_error_details(code, error.message(), details)
    }
}

#[cfg(test)]
mod tests {
    use tidemap_map::name::MapName;

    use super::*;

    #[test]
    fn clients_of_a_daemon_that_does_not_write_a_map_receive_a_retry_and_the_writer() {
        let writer = Some("b".to_owned());
        let refused = NotWriter { map: MapName::new("office").expect("valid"), writer: writer.clone() };
        let in_flight = AppendError::NotWriter { writer: writer.clone() };
        let errors = [
            RpcError::from(HelloError::from(refused.clone())),
            RpcError::from(AddStateError::from(refused.clone())),
            RpcError::from(EditSiteError::from(refused.clone())),
            RpcError::from(refused),
            RpcError::from(HelloError::Storage(in_flight.clone())),
            RpcError::Ended(Ending::from(in_flight)),
        ];
        for error in errors {
            assert_eq!(error.code_and_reason(), (Code::Unavailable, "NOT_WRITER"), "{error:?}");
            assert!(error.message().split_whitespace().any(|word| word == "b"), "{error:?}");
        }
        let full = RpcError::Ended(Ending::from(AppendError::StreamFull("office".to_owned())));
        assert_eq!(full.code_and_reason(), (Code::ResourceExhausted, "DISK_FULL"));
    }
}
