//! Connections to a daemon: address, token, channels.
//!
//! Invariant: at most 32 Observe streams share a connection, so that the stream limit of the server and the shared flow
//! control of a connection do not block other streams. Requests use a connection of their own.

use std::{
    fmt,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use tonic::{
    Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Channel, Endpoint},
};

use crate::error::Error;

/// Streams that share a connection.
const STREAMS_PER_CONNECTION: usize = 32;
/// Maximum size of a reply: what the daemon itself allows. The usual 4 MiB are less than an evaluation of many thousand
/// states needs.
pub(crate) const REPLY_BYTES_MAX: usize = 64 << 20;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A daemon whose machine is gone is detected after the interval and the timeout.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(20);
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);

/// A gRPC channel that sends the token.
pub type Connection = InterceptedService<Channel, Bearer>;

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

/// A client of a daemon. Cheap to clone; clones share connections.
#[derive(Clone, Debug)]
pub struct Client {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    server: String,
    endpoint: Endpoint,
    bearer: Bearer,
    requests: Connection,
    /// Number of open streams of each stream connection. The lock is held while counting, when a stream opens or
    /// closes.
    streams: Mutex<Vec<(Connection, usize)>>,
}

impl Client {
    /// A client of the daemon at `url`, which is `HOST:PORT`, `http://HOST:PORT`, or `unix:PATH` for a Unix socket of
    /// this machine. Connections are opened when needed,
    /// and reopened after they break.
    ///
    /// # Errors
    /// [`Error::Address`].
    pub fn new(url: &str) -> Result<Self, Error> {
        Self::with_bearer(url, Bearer(None))
    }

    /// As [`Client::new`], with a token that is sent with each request.
    ///
    /// # Errors
    /// [`Error::Address`], [`Error::Token`].
    pub fn with_token(url: &str, token: &str) -> Result<Self, Error> {
        let mut value: MetadataValue<Ascii> = format!("Bearer {token}").parse().map_err(|_| Error::Token)?;
        value.set_sensitive(true);
        Self::with_bearer(url, Bearer(Some(value)))
    }

    /// As [`Client::new`], and checks that a daemon is listening.
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

    fn with_bearer(url: &str, bearer: Bearer) -> Result<Self, Error> {
        let server = normalised(url)?;
        let endpoint = Endpoint::from_shared(server.clone())
            .map_err(|_| Error::Address { url: url.to_owned(), hint: "" })?
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEPALIVE_INTERVAL)
            .keep_alive_timeout(KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true)
            .tcp_nodelay(true);
        let requests = InterceptedService::new(endpoint.connect_lazy(), bearer.clone());
        let inner = Inner { server, endpoint, bearer, requests, streams: Mutex::new(Vec::new()) };
        Ok(Self { inner: Arc::new(inner) })
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
            streams.push((InterceptedService::new(channel, self.inner.bearer.clone()), 0));
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
    let with_scheme = match url.split_once("://") {
        Some(("http", _)) => url.to_owned(),
        Some(("https", _)) => return Err(wrong("; https is not in this version")),
        Some(_) => return Err(wrong("")),
        None => format!("http://{url}"),
    };
    let authority = with_scheme["http://".len()..].trim_end_matches('/');
    let port =
        authority.rsplit_once(':').and_then(|(host, port)| port.parse::<u16>().ok().filter(|_| !host.is_empty()));
    match port {
        Some(0) | None => Err(wrong("; the port is missing or not a number from 1 to 65535")),
        Some(_) => Ok(format!("http://{authority}")),
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
            ("unix:/run/tidemapd/socket", "unix:/run/tidemapd/socket"),
        ] {
            assert_eq!(normalised(url), Ok(server.to_owned()));
        }
        for url in
            ["", "localhost", "localhost:http", ":7435", "localhost:0", "https://localhost:7435", "ftp://a:1", "unix:"]
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

    #[test]
    fn a_token_is_not_shown() {
        assert!(!format!("{:?}", Bearer("Bearer secret".parse().ok())).contains("secret"));
    }
}
