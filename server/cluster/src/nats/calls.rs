//! Requests to NATS, and the meaning of a reply or of its absence.
//!
//! Invariant: a call returns [`EngineError::Unavailable`] only where no server can have taken the request: before it is
//! sent, or where a server has replied that nobody listens or that it has not acted.

use std::{
    collections::BTreeSet,
    io,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use async_nats::{
    Client, ConnectError, ConnectErrorKind, ConnectOptions, Event, HeaderMap, Request, RequestError, RequestErrorKind,
    ServerAddr, ServerError, ServerInfo,
    connection::State,
    jetstream::{
        self, ErrorCode, context::ContextBuilder, message::StreamMessage, publish::PublishAck, response::Response,
        stream::RawMessage,
    },
};
use bytes::Bytes;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::settings::{NatsCredentials, NatsSettings};
use crate::engine::EngineError;

/// The longest pause between two attempts to connect.
const RECONNECT_PAUSE_MAX: Duration = Duration::from_millis(500);

/// The client gives up a server that answers no ping for two of these intervals.
const PING_INTERVAL: Duration = Duration::from_secs(1);

/// Time limit of an attempt to connect.
const CONNECT_PATIENCE: Duration = Duration::from_secs(2);

/// Time limit for the creation of a consumer.
const CONSUMER_PATIENCE: Duration = Duration::from_secs(2);

/// The reason why a call has no result.
#[derive(Debug)]
pub(super) enum CallError {
    /// The error that JetStream returned.
    Api(jetstream::Error),
    Engine(EngineError),
}

impl From<CallError> for EngineError {
    fn from(error: CallError) -> Self {
        match error {
            CallError::Api(error) => from_api(&error),
            CallError::Engine(error) => error,
        }
    }
}

/// The outcome of publishing a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Published {
    Appended(u64),
    NotExpected,
}

/// The refusals of the servers on this connection.
#[derive(Default)]
struct Refusals {
    /// The reason why the last attempt to connect was refused.
    connection: Option<String>,
    /// Subjects to which this client may not publish.
    subjects: BTreeSet<String>,
}

/// The connection. Clones share it.
#[derive(Clone)]
pub(super) struct NatsCalls {
    client: Client,
    context: jetstream::Context,
    request_time_out: Duration,
    refusals: Arc<Mutex<Refusals>>,
}

#[derive(Deserialize)]
struct RawReply {
    message: RawMessage,
}

impl NatsCalls {
    pub(super) async fn connect(settings: &NatsSettings) -> Result<Self, EngineError> {
        let refusals = Arc::new(Mutex::new(Refusals::default()));
        let noted = Arc::clone(&refusals);
        let options = options(settings)?.event_callback(move |event| {
            note(&mut lock(&noted), event);
            std::future::ready(())
        });
        let client = options.connect(servers(settings)?).await.map_err(|error| from_connect(&error))?;
        let context = ContextBuilder::new().timeout(CONSUMER_PATIENCE).build(client.clone());
        Ok(Self { client, context, request_time_out: settings.request_time_out, refusals })
    }

    pub(super) fn client(&self) -> &Client {
        &self.client
    }

    /// The context in which consumers are made.
    pub(super) fn context(&self) -> &jetstream::Context {
        &self.context
    }

    pub(super) fn request_time_out(&self) -> Duration {
        self.request_time_out
    }

    /// The data of the server to which this client is connected, as the server reports it.
    pub(super) fn server(&self) -> ServerInfo {
        self.client.server_info()
    }

    pub(super) fn check_connection(&self) -> Result<(), EngineError> {
        if self.client.connection_state() == State::Connected {
            return Ok(());
        }
        Err(match lock(&self.refusals).connection.clone() {
            Some(reason) => EngineError::Refused(reason),
            None => EngineError::Unavailable("no connection".to_owned()),
        })
    }

    /// Sends a request and waits for its reply.
    async fn request(&self, subject: String, request: Request, patience: Duration) -> Result<Bytes, EngineError> {
        // The client keeps a message that is sent without a connection. It would take effect long after its sender has
        // given up.
        self.check_connection()?;
        match self.client.send_request(subject.clone(), request.timeout(Some(patience))).await {
            Ok(message) => Ok(message.payload),
            Err(_) if lock(&self.refusals).subjects.contains(&subject) => {
                Err(EngineError::Refused(format!("this client may not publish to {subject}")))
            }
            Err(error) => Err(from_request(&error)),
        }
    }

    /// A call of JetStream's interface.
    pub(super) async fn api<T: DeserializeOwned>(
        &self,
        api: &str,
        request: &impl Serialize,
        patience: Duration,
    ) -> Result<T, CallError> {
        let unreadable = |error: serde_json::Error| CallError::Engine(EngineError::Refused(format!("{api}: {error}")));
        let payload = serde_json::to_vec(request).map_err(unreadable)?;
        let request = Request::new().payload(payload.into());
        let reply = self.request(format!("$JS.API.{api}"), request, patience).await.map_err(CallError::Engine)?;
        match serde_json::from_slice(&reply).map_err(unreadable)? {
            Response::Ok(answer) => Ok(answer),
            Response::Err { error } => Err(CallError::Api(error)),
        }
    }

    /// A message as the leader has it; `None` where the stream does not hold it.
    pub(super) async fn message(
        &self,
        name: &str,
        which: &impl Serialize,
    ) -> Result<Option<StreamMessage>, EngineError> {
        let api = format!("STREAM.MSG.GET.{name}");
        match self.api::<RawReply>(&api, which, self.request_time_out).await {
            Ok(reply) => {
                let message = StreamMessage::try_from(reply.message);
                message.map(Some).map_err(|error| EngineError::Refused(format!("{api}: {error}")))
            }
            Err(CallError::Api(error)) if error.error_code() == ErrorCode::NO_MESSAGE_FOUND => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Publishes a message and waits until its stream has it.
    pub(super) async fn publish(
        &self,
        subject: String,
        headers: HeaderMap,
        content: Bytes,
        patience: Duration,
    ) -> Result<Published, EngineError> {
        let request = Request::new().headers(headers).payload(content);
        let reply = self.request(subject, request, patience).await?;
        // A reply that cannot be read does not show whether the stream has the message.
        match serde_json::from_slice(&reply).map_err(|error| EngineError::Unknown(error.to_string()))? {
            Response::Ok(PublishAck { sequence, .. }) => Ok(Published::Appended(sequence)),
            Response::Err { error } => match error.error_code() {
                ErrorCode::STREAM_WRONG_LAST_SEQUENCE | ErrorCode::STREAM_WRONG_LAST_SEQUENCE_CONSTANT => {
                    Ok(Published::NotExpected)
                }
                _ => Err(from_api(&error)),
            },
        }
    }
}

fn lock(refusals: &Mutex<Refusals>) -> MutexGuard<'_, Refusals> {
    refusals.lock().unwrap_or_else(PoisonError::into_inner)
}

fn servers(settings: &NatsSettings) -> Result<Vec<ServerAddr>, EngineError> {
    let parse = |url: &String| url.parse().map_err(|error| EngineError::Refused(format!("a server's URL: {error}")));
    settings.servers.iter().map(parse).collect()
}

fn options(settings: &NatsSettings) -> Result<ConnectOptions, EngineError> {
    let unreadable = |path: &Path| {
        let path = path.display().to_string();
        move |error: io::Error| EngineError::Refused(format!("{path} cannot be read: {error}"))
    };
    let pause = |attempts: usize| {
        let attempts = u32::try_from(attempts.saturating_sub(1)).unwrap_or(u32::MAX);
        Duration::from_millis(25).saturating_mul(attempts).min(RECONNECT_PAUSE_MAX)
    };
    let mut options = ConnectOptions::new()
        .name(&settings.client)
        .request_timeout(Some(settings.request_time_out))
        .connection_timeout(CONNECT_PATIENCE)
        .ping_interval(PING_INTERVAL)
        .max_reconnects(None)
        .reconnect_delay_callback(pause)
        // Use only the servers of the settings: they can be reached, and the certificates have their names.
        .ignore_discovered_servers();
    // The client library takes no user from a URL.
    if let Some(server) = servers(settings)?.iter().find(|server| server.has_user_pass()) {
        let user = server.username().unwrap_or_default().to_owned();
        options = match server.password() {
            Some(password) => options.user_and_password(user, password.to_owned()),
            None => options.token(user),
        };
    }
    match &settings.credentials {
        NatsCredentials::None => {}
        NatsCredentials::File(path) => {
            let text = std::fs::read_to_string(path).map_err(unreadable(path))?;
            options = options.credentials(&text).map_err(unreadable(path))?;
        }
        NatsCredentials::NkeySeed(path) => {
            let seed = std::fs::read_to_string(path).map_err(unreadable(path))?;
            options = options.nkey(seed.trim().to_owned());
        }
    }
    if let Some(tls) = &settings.tls {
        options = options.require_tls(true);
        if let Some(authority) = &tls.authority {
            options = options.add_root_certificates(authority.clone());
        }
        if let Some((certificate, key)) = &tls.client {
            options = options.add_client_certificate(certificate.clone(), key.clone());
        }
    }
    Ok(options)
}

/// Records a refusal of a server.
fn note(refusals: &mut Refusals, event: Event) {
    match event {
        Event::Connected => *refusals = Refusals::default(),
        Event::ServerError(ServerError::AuthorizationViolation) => {
            refusals.connection = Some("authorization violation".to_owned());
        }
        Event::ServerError(ServerError::Other(text)) => {
            let subject = text.to_lowercase().starts_with("permissions violation for publish to");
            if let Some(subject) = text.split('"').nth(1).filter(|_| subject) {
                refusals.subjects.insert(subject.to_owned());
            }
            tracing::warn!(text, "the engine refuses a call");
        }
        event => tracing::debug!(%event, "connection to the engine"),
    }
}

fn from_connect(error: &ConnectError) -> EngineError {
    let text = error.to_string();
    match error.kind() {
        ConnectErrorKind::Authentication
        | ConnectErrorKind::AuthorizationViolation
        | ConnectErrorKind::ServerParse
        | ConnectErrorKind::Tls => EngineError::Refused(text),
        _ => EngineError::Unavailable(text),
    }
}

fn from_request(error: &RequestError) -> EngineError {
    let text = error.to_string();
    match error.kind() {
        RequestErrorKind::NoResponders => EngineError::Unavailable(text),
        RequestErrorKind::InvalidSubject | RequestErrorKind::MaxPayloadExceeded => EngineError::Refused(text),
        RequestErrorKind::TimedOut | RequestErrorKind::Other => EngineError::Unknown(text),
    }
}

/// The meaning of an error of JetStream.
pub(super) fn from_api(error: &jetstream::Error) -> EngineError {
    let text = error.to_string();
    match error.error_code() {
        ErrorCode::STREAM_NOT_FOUND => EngineError::Missing("stream".to_owned()),
        ErrorCode::ACCOUNT_RESOURCES_EXCEEDED
        | ErrorCode::INSUFFICIENT_RESOURCES
        | ErrorCode::MEMORY_RESOURCES_EXCEEDED
        | ErrorCode::STORAGE_RESOURCES_EXCEEDED
        | ErrorCode::STREAM_MAX_STREAM_BYTES_EXCEEDED => EngineError::Full(text),
        // The store's error: at its limit it has refused the message; otherwise it may have written it.
        ErrorCode::STREAM_STORE_FAILED if text.contains("maximum") => EngineError::Full(text),
        ErrorCode::STREAM_STORE_FAILED | ErrorCode::RAFT_GENERAL | ErrorCode::STREAM_GENERALOR => {
            EngineError::Unknown(text)
        }
        ErrorCode::CLUSTER_INCOMPLETE
        | ErrorCode::CLUSTER_NOT_ACTIVE
        | ErrorCode::CLUSTER_NOT_ASSIGNED
        | ErrorCode::CLUSTER_NOT_AVAILABLE
        | ErrorCode::CLUSTER_NOT_LEADER
        | ErrorCode::CLUSTER_NO_PEERS
        | ErrorCode::CLUSTER_PEER_NOT_MEMBER
        | ErrorCode::CONSUMER_OFFLINE
        | ErrorCode::STREAM_EXPECTED_LAST_SEQ_PER_SUBJECT_NOT_READY
        | ErrorCode::STREAM_OFFLINE
        | ErrorCode::STREAM_OFFLINE_REASON
        | ErrorCode::STREAM_TOO_MANY_REQUESTS => EngineError::Unavailable(text),
        _ if error.code() == 503 => EngineError::Unavailable(text),
        _ => EngineError::Refused(text),
    }
}
