//! Connections to a daemon: address, token, channels.
//!
//! Invariant: at most 32 Observe streams share a connection, so that the stream limit of the server and the shared flow
//! control of a connection do not block other streams. Requests use a connection of their own.

use std::{
    fmt,
    net::IpAddr,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use tonic::{
    Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Channel, Endpoint},
};

use crate::{
    error::Error,
    read_tokens::{ReadTokens, TokenService},
};

mod secure;

use secure::SecureConnector;

/// Streams that share a connection.
const STREAMS_PER_CONNECTION: usize = 32;
/// Maximum size of a reply: the limit of the daemon itself. The usual 4 MiB are less than an evaluation of many
/// thousand states needs.
pub(crate) const REPLY_BYTES_MAX: usize = 64 << 20;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A daemon whose machine is gone is detected after the interval and the timeout.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(20);
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);

/// The begin of a certificate.
const PEM_BEGIN: &[u8] = b"-----BEGIN CERTIFICATE-----";

/// A gRPC channel that sends the token, and the read token of a map that daemons share.
pub type Connection = TokenService<InterceptedService<Channel, Bearer>>;

/// Adds `authorization: Bearer …` to each request if there is a token.
#[derive(Clone)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl fmt::Debug for Bearer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "Bearer([redacted])" } else { "Bearer(none)" })
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: tonic::Request<()>) -> Result<tonic::Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// The credentials that a client and a daemon present to each other. `Debug` shows no secret.
#[derive(Clone, Default)]
pub struct Credentials {
    /// The token that determines what the client may do.
    pub token: Option<String>,
    /// Certificates of the authorities that the daemon's certificate may come from, in PEM form. `https://` needs them.
    pub ca: Option<Vec<u8>>,
    /// The client's certificate and its private key, in PEM form, for a daemon that requires one.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |is_there: bool| if is_there { "[redacted]" } else { "none" };
        f.debug_struct("Credentials")
            .field("token", &shown(self.token.is_some()))
            .field("ca", &self.ca.is_some())
            .field("identity", &shown(self.identity.is_some()))
            .finish()
    }
}

impl Credentials {
    /// The connector that opens connections with TLS; `None` without TLS.
    ///
    /// # Errors
    /// [`Error::Tls`]
    fn connector(&self, is_tls: bool) -> Result<Option<SecureConnector>, Error> {
        let wrong = |text: &str| Err(Error::Tls(text.to_owned()));
        match (&self.ca, &self.identity) {
            (None, None) if !is_tls => Ok(None),
            _ if !is_tls => wrong("certificates are of use only with an address that begins with https://"),
            (None, _) => {
                wrong("an address with https:// needs the certificate of the authority that signed the daemon's")
            }
            (Some(ca), _) if !ca.windows(PEM_BEGIN.len()).any(|part| part == PEM_BEGIN) => {
                wrong("the file of authorities holds no certificate in PEM form")
            }
            (Some(ca), identity) => SecureConnector::new(ca, identity.as_ref()).map(Some),
        }
    }
}

/// Whether an address is on this machine: a token needs TLS on any other address.
fn is_of_this_machine(server: &str) -> bool {
    let Some(authority) = server.strip_prefix("http://") else { return server.starts_with("unix:") };
    let host = authority.rsplit_once(':').map_or(authority, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// The address of a daemon, and the way to open connections to it.
#[derive(Clone, Debug)]
struct DaemonEndpoint {
    endpoint: Endpoint,
    connector: Option<SecureConnector>,
}

impl DaemonEndpoint {
    fn new(server: &str, connector: Option<SecureConnector>) -> Result<Self, Error> {
        let invalid = || Error::Address { url: server.to_owned(), hint: "" };
        let origin = server.to_owned();
        // The connector does TLS itself: tonic would add TLS of its own to an https address.
        let reached = if connector.is_some() { server.replacen("https:", "http:", 1) } else { origin.clone() };
        let mut endpoint = Endpoint::from_shared(reached)
            .map_err(|_| invalid())?
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEPALIVE_INTERVAL)
            .keep_alive_timeout(KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true)
            .tcp_nodelay(true);
        if connector.is_some() {
            endpoint = endpoint.origin(origin.parse().map_err(|_| invalid())?);
        }
        Ok(Self { endpoint, connector })
    }

    fn connect_lazy(&self) -> Channel {
        match &self.connector {
            Some(connector) => self.endpoint.connect_with_connector_lazy(connector.clone()),
            None => self.endpoint.connect_lazy(),
        }
    }

    async fn connect(&self) -> Result<Channel, tonic::transport::Error> {
        match &self.connector {
            Some(connector) => self.endpoint.connect_with_connector(connector.clone()).await,
            None => self.endpoint.connect().await,
        }
    }
}

/// A client of a daemon. Cheap to clone; clones share connections.
#[derive(Clone, Debug)]
pub struct Client {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    server: String,
    endpoint: DaemonEndpoint,
    bearer: Bearer,
    requests: Connection,
    tokens: ReadTokens,
    /// Number of open streams of each stream connection. The lock is held while counting, when a stream opens or
    /// closes.
    streams: Mutex<Vec<(Connection, usize)>>,
}

impl Client {
    /// A client of the daemon at `url`, which is `HOST:PORT`, `http://HOST:PORT`, or `unix:PATH` for a Unix socket of
    /// this machine. Connections are opened when needed, and reopened after they break.
    ///
    /// # Errors
    /// [`Error::Address`].
    pub fn new(url: &str) -> Result<Self, Error> {
        Self::with_credentials(url, &Credentials::default())
    }

    /// Does the same as [`Client::new`], with a token that is sent with each request.
    ///
    /// # Errors
    /// [`Error::Address`], [`Error::Token`], [`Error::TokenInClear`].
    pub fn with_token(url: &str, token: &str) -> Result<Self, Error> {
        Self::with_credentials(url, &Credentials { token: Some(token.to_owned()), ..Credentials::default() })
    }

    /// Does the same as [`Client::new`], also for `https://HOST:PORT`, with the credentials of the two sides.
    ///
    /// # Errors
    /// [`Error::Address`], [`Error::Token`], [`Error::TokenInClear`], [`Error::Tls`].
    pub fn with_credentials(url: &str, credentials: &Credentials) -> Result<Self, Error> {
        let server = normalised(url)?;
        let is_tls = server.starts_with("https:");
        let bearer = match &credentials.token {
            None => Bearer(None),
            Some(_) if !is_tls && !is_of_this_machine(&server) => return Err(Error::TokenInClear { server }),
            Some(token) => {
                let mut value: MetadataValue<Ascii> = format!("Bearer {token}").parse().map_err(|_| Error::Token)?;
                value.set_sensitive(true);
                Bearer(Some(value))
            }
        };
        let connector = credentials.connector(is_tls)?;
        Self::with_bearer(server, connector, bearer)
    }

    /// Does the same as [`Client::new`], and checks that a daemon is listening.
    ///
    /// # Errors
    /// [`Error::Address`], [`Error::Unreachable`].
    pub async fn connect(url: &str) -> Result<Self, Error> {
        let client = Self::new(url)?;
        match client.inner.endpoint.connect().await {
            Ok(_) => Ok(client),
            Err(error) => Err(Error::from_status(client.server(), &Status::from_error(Box::new(error)))),
        }
    }

    fn with_bearer(server: String, connector: Option<SecureConnector>, bearer: Bearer) -> Result<Self, Error> {
        let endpoint = DaemonEndpoint::new(&server, connector)?;
        Ok(Self::of_parts(server, endpoint, bearer, ReadTokens::default()))
    }

    /// A client of the same daemon with the same credentials, and with connections of its own.
    #[must_use]
    pub fn with_own_connections(&self) -> Self {
        let Inner { server, endpoint, bearer, tokens, .. } = &*self.inner;
        Self::of_parts(server.clone(), endpoint.clone(), bearer.clone(), tokens.clone())
    }

    /// A client of the same daemon, for a daemon of a cluster: the replies show at least the data that `other` has seen
    /// of a map at another daemon, and the other way round. The new client has connections of its own.
    #[must_use]
    pub fn with_read_tokens_of(&self, other: &Client) -> Self {
        let Inner { server, endpoint, bearer, .. } = &*self.inner;
        Self::of_parts(server.clone(), endpoint.clone(), bearer.clone(), other.inner.tokens.clone())
    }

    fn of_parts(server: String, endpoint: DaemonEndpoint, bearer: Bearer, tokens: ReadTokens) -> Self {
        let channel = InterceptedService::new(endpoint.connect_lazy(), bearer.clone());
        let requests = TokenService::new(channel, tokens.clone());
        Self { inner: Arc::new(Inner { server, endpoint, bearer, requests, tokens, streams: Mutex::new(Vec::new()) }) }
    }

    /// The read token of each map. Clients with connections of their own share these tokens.
    pub(crate) fn tokens(&self) -> &ReadTokens {
        &self.inner.tokens
    }

    /// The daemon's address.
    #[must_use]
    pub fn server(&self) -> &str {
        &self.inner.server
    }

    /// The connection that requests share, for callers that use the generated types directly.
    #[must_use]
    pub fn requests(&self) -> Connection {
        self.inner.requests.clone()
    }

    /// Reserves a place for one Observe stream on a connection with room.
    #[must_use]
    pub fn stream_place(&self) -> StreamPlace {
        let mut streams = self.inner.streams.lock().unwrap_or_else(PoisonError::into_inner);
        let index = streams.iter().position(|(_, open)| *open < STREAMS_PER_CONNECTION).unwrap_or_else(|| {
            let channel = self.inner.endpoint.connect_lazy();
            let channel = InterceptedService::new(channel, self.inner.bearer.clone());
            streams.push((TokenService::new(channel, self.inner.tokens.clone()), 0));
            streams.len() - 1
        });
        streams[index].1 += 1;
        StreamPlace { client: self.clone(), index, connection: streams[index].0.clone() }
    }

    pub(crate) fn error(&self, status: &Status) -> Error {
        Error::from_status(self.server(), status)
    }
}

/// A place for one stream on a connection; released when dropped.
#[derive(Debug)]
pub struct StreamPlace {
    client: Client,
    index: usize,
    connection: Connection,
}

impl StreamPlace {
    /// The connection.
    #[must_use]
    pub fn connection(&self) -> Connection {
        self.connection.clone()
    }
}

impl Drop for StreamPlace {
    fn drop(&mut self) {
        let mut streams = self.client.inner.streams.lock().unwrap_or_else(PoisonError::into_inner);
        streams[self.index].1 -= 1;
    }
}

fn normalised(url: &str) -> Result<String, Error> {
    if let Some(path) = url.strip_prefix("unix:") {
        let hint = "; the path of a Unix socket is missing, as in unix:/run/tidemapd/socket";
        let is_path = !path.trim_start_matches("//").is_empty();
        return if is_path { Ok(url.to_owned()) } else { Err(Error::Address { url: url.to_owned(), hint }) };
    }
    let wrong = |hint| Error::Address { url: url.to_owned(), hint };
    let (scheme, authority) = match url.split_once("://") {
        Some((scheme @ ("http" | "https"), rest)) => (scheme, rest),
        Some(_) => return Err(wrong("")),
        None => ("http", url),
    };
    let authority = authority.trim_end_matches('/');
    let port =
        authority.rsplit_once(':').and_then(|(host, port)| port.parse::<u16>().ok().filter(|_| !host.is_empty()));
    match port {
        Some(0) | None => Err(wrong("; the port is missing or not a number from 1 to 65535")),
        Some(_) => Ok(format!("{scheme}://{authority}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_may_leave_out_the_scheme() {
        for (url, server) in [
            ("127.0.0.1:7435", "http://127.0.0.1:7435"),
            ("http://robot.local:1/", "http://robot.local:1"),
            ("[::1]:7435", "http://[::1]:7435"),
            ("https://localhost:7435/", "https://localhost:7435"),
            ("unix:/run/tidemapd/socket", "unix:/run/tidemapd/socket"),
        ] {
            assert_eq!(normalised(url), Ok(server.to_owned()));
        }
        for url in
            ["", "localhost", "localhost:http", ":7435", "localhost:0", "https://localhost", "ftp://a:1", "unix:"]
        {
            assert!(matches!(normalised(url), Err(Error::Address { .. })), "{url}");
        }
    }

    #[tokio::test]
    async fn a_connection_carries_32_streams() -> Result<(), Error> {
        let client = Client::new("127.0.0.1:1")?;
        let mut places: Vec<_> = (0..33).map(|_| client.stream_place()).collect();
        assert_eq!((places[31].index, places[32].index), (0, 1));
        places.remove(0);
        assert_eq!(client.stream_place().index, 0, "a place that was given back is taken again");
        Ok(())
    }

    #[tokio::test]
    async fn a_token_leaves_this_machine_only_with_tls() {
        for server in ["http://127.0.0.1:1", "[::1]:1", "localhost:1", "unix:/run/socket"] {
            assert!(Client::with_token(server, "tm").is_ok(), "{server}");
        }
        for server in ["http://10.0.0.1:1", "robot.local:1", "127.0.0.1.example.org:1"] {
            let refused = Client::with_token(server, "tm");
            assert!(matches!(refused, Err(Error::TokenInClear { .. })), "{server}");
        }
    }

    #[tokio::test]
    async fn tls_needs_an_authority_and_certificates_need_tls() {
        assert!(matches!(Client::new("https://localhost:1"), Err(Error::Tls(_))));
        let credentials = Credentials { ca: Some(b"no certificate".to_vec()), ..Credentials::default() };
        assert!(matches!(Client::with_credentials("http://localhost:1", &credentials), Err(Error::Tls(_))));
        assert!(matches!(Client::with_credentials("https://localhost:1", &credentials), Err(Error::Tls(_))));
    }

    #[test]
    fn secrets_are_not_shown() {
        assert!(!format!("{:?}", Bearer("Bearer secret".parse().ok())).contains("secret"));
        let identity = Some((b"chain".to_vec(), b"secret".to_vec()));
        let shown = format!("{:?}", Credentials { token: Some("secret".to_owned()), ca: None, identity });
        assert!(!shown.contains("secret") && !shown.contains("115"), "{shown}");
    }
}
