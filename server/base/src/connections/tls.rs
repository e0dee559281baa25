//! TLS of connections: TLS 1.3 only, with the daemon's certificate and, where an authority is named, a certificate of
//! the client.
//!
//! Invariant: the handshake is driven by the first read or write, so that the deadline of a connection's first request
//! covers it. A certificate that cannot be used, or that clients would not take now, never replaces a usable one.
//! Errors name files, and never contain the content of a file. A client whose handshake fails receives the reason: the
//! daemon does not break a connection with bytes of the client on their way before the client has read the alert.

use std::{
    fmt,
    fs::File,
    io::{self, Read as _},
    net::SocketAddr,
    os::unix::fs::{MetadataExt as _, PermissionsExt as _},
    path::{Path, PathBuf},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};

use arc_swap::ArcSwap;
use tidemap_model::time::format_rfc3339;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::TcpStream,
    time::{Sleep, sleep},
};
use tokio_rustls::{
    FallibleAccept, TlsAcceptor,
    rustls::{
        self, RootCertStore, ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
        server::WebPkiClientVerifier,
        version::TLS13,
    },
    server::TlsStream,
};
use tracing::{error, info, warn};

use super::certificate::{self, Facts, NotForServers};
use crate::{
    clock::{Clock as _, SystemClock},
    secret_file::{is_open_to_all, is_private},
    telemetry::occasional::Occasional,
};

/// The protocol of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// HTTP/2 with prior knowledge, as gRPC.
    Http2,
    /// HTTP/1.
    Http1,
}

/// Maximum number of bytes that a connection of the HTTP port keeps of a reply that is not read.
const HTTP_BUFFER_BYTES: usize = 16 << 10;

static FAILURES: Occasional = Occasional::new();

/// Maximum time for the client to close its side after the alert of a handshake that failed.
const REFUSED_LINGER: Duration = Duration::from_secs(1);
/// Maximum number of bytes of the client that are read and ignored meanwhile.
const REFUSED_BYTES: usize = 64 << 10;

/// The files of the daemon's TLS, in PEM form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The daemon's certificate, followed by the certificates of the authorities between it and the root.
    pub certificate: PathBuf,
    /// The private key of the daemon's certificate.
    pub key: PathBuf,
    /// Authorities of clients; if set, each client must present a certificate of one of them.
    pub client_ca: Option<PathBuf>,
    /// The host by which other daemons reach this one over TLS, if there are any.
    pub advertised: Option<String>,
}

/// The reason why files of TLS cannot be used.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum TlsError {
    #[error("setting {setting}: {} cannot be read: {source}", .path.display())]
    Read { setting: &'static str, path: PathBuf, source: io::Error },
    #[error("setting {setting}: {} contains no {what} in PEM form", .path.display())]
    Missing { setting: &'static str, path: PathBuf, what: &'static str },
    #[error(
        "setting tls_key: {} has permissions {mode:o}, so that everybody on this machine can read or change the key. \
         Run chmod 600 {}",
        .path.display(), .path.display()
    )]
    Open { path: PathBuf, mode: u32 },
    #[error(
        "setting tls_certificate: the certificate in {} has expired, it was valid until {}. Put a new one in its place",
        .path.display(), shown(*.until_secs)
    )]
    Expired { path: PathBuf, until_secs: i64 },
    #[error(
        "setting tls_certificate: the certificate in {} is not valid before {}, and this machine's clock is at {}. Set \
         the clock, or wait",
        .path.display(), shown(*.from_secs), shown(*.now_secs)
    )]
    NotYetValid { path: PathBuf, from_secs: i64, now_secs: i64 },
    #[error("setting tls_certificate: the first certificate in {} cannot be read", .path.display())]
    Unreadable { path: PathBuf },
    #[error(
        "setting tls_certificate: the certificate in {} is not for servers: {why}. Clients would refuse to connect; put \
         one for servers in its place", .path.display()
    )]
    NotForServers { path: PathBuf, why: NotForServers },
    #[error(
        "setting tls_certificate: the certificate in {} names no host: clients need the name or address that they \
         connect to in its subject alternative names. Make a certificate with the daemon's names and addresses",
        .path.display()
    )]
    NoNames { path: PathBuf },
    #[error(
        "setting tls_certificate: the certificate in {} is not for {host}, which is this daemon's host in setting \
         cluster.advertise. It is for {}", .path.display(), .names.join(", ")
    )]
    NotAdvertised { path: PathBuf, host: String, names: Vec<String> },
    #[error(
        "setting tls_certificate: the certificate in {} is for {}, and the one in use for {}: clients would not accept \
         it. If the daemon has other names now, start it again", .path.display(), .names.join(", "), .before.join(", ")
    )]
    OtherNames { path: PathBuf, names: Vec<String>, before: Vec<String> },
    #[error(
        "setting tls_certificate: the first certificate in {} is signed by none of those behind it. Put the daemon's own \
         first, and behind it that of its issuer", .path.display()
    )]
    Chain { path: PathBuf },
    #[error(
        "setting tls_certificate: {} lacks the certificate of its issuer, which the file in use includes. Add it after \
         the daemon's own", .path.display()
    )]
    NoIssuer { path: PathBuf },
    #[error("settings tls_certificate and tls_key cannot be used together: {0}")]
    Pair(rustls::Error),
    #[error("setting tls_client_ca: {} cannot be used: {reason}", .path.display())]
    ClientCa { path: PathBuf, reason: String },
}

/// A time in seconds since 1970, as text for people.
fn shown(secs: i64) -> String {
    format_rfc3339(secs.saturating_mul(1_000_000_000))
}

impl TlsFiles {
    /// The files, whose changes are followed.
    pub fn paths(&self) -> Vec<PathBuf> {
        [&self.certificate, &self.key].into_iter().chain(&self.client_ca).cloned().collect()
    }

    fn certificates(setting: &'static str, path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
        let text = read(setting, path)?;
        let found = CertificateDer::pem_slice_iter(&text).collect::<Result<Vec<_>, _>>();
        let missing = || TlsError::Missing { setting, path: path.to_owned(), what: "certificate" };
        found.ok().filter(|found| !found.is_empty()).ok_or_else(missing)
    }

    /// Sets the metric of the time by which the daemon's certificate has to be replaced: when it, or one after it in
    /// the file, ends.
    fn report_end(chain: &[CertificateDer<'static>]) {
        let ends = chain.iter().filter_map(|known| certificate::facts(known)).map(|facts| facts.until_secs);
        if let Some(ends_secs) = ends.min() {
            metrics::gauge!("tidemap_certificate_expiry_seconds").set(ends_secs as f64);
        }
    }

    /// Whether clients can accept the daemon's own certificate now. The certificates after it in the file may not be
    /// needed.
    fn check_dates(&self, own: &Facts) -> Result<(), TlsError> {
        let now_secs = SystemClock.now_nanos().div_euclid(1_000_000_000);
        let (path, from_secs, until_secs) = (|| self.certificate.clone(), own.from_secs, own.until_secs);
        if until_secs < now_secs {
            return Err(TlsError::Expired { path: path(), until_secs });
        }
        if from_secs > now_secs {
            return Err(TlsError::NotYetValid { path: path(), from_secs, now_secs });
        }
        Ok(())
    }

    /// Whether clients can accept the daemon's own certificate at all: for servers, for the daemon's names, and with
    /// the certificates of its issuers. `before` is the certificate that it replaces.
    fn check_use(
        &self,
        own: &Facts,
        chain: &[CertificateDer<'static>],
        before: Option<&InUse>,
    ) -> Result<(), TlsError> {
        let (path, names) = (|| self.certificate.clone(), || own.names.clone());
        if let Some(why) = own.not_for_servers {
            return Err(TlsError::NotForServers { path: path(), why });
        }
        let Some(first) = chain.first().filter(|_| !own.names.is_empty()) else {
            return Err(TlsError::NoNames { path: path() });
        };
        if let Some(host) = self.advertised.as_ref().filter(|host| !certificate::is_for(first, host)) {
            return Err(TlsError::NotAdvertised { path: path(), host: host.clone(), names: names() });
        }
        if chain.len() > 1 && !own.is_self_issued() && !certificate::is_signed_within(chain, own.from_secs) {
            return Err(TlsError::Chain { path: path() });
        }
        let Some(before) = before else { return Ok(()) };
        if before.names_kept(own, first).next().is_none() {
            return Err(TlsError::OtherNames { path: path(), names: names(), before: before.own.names.clone() });
        }
        // An issuer that the daemon had to send before has to be sent now.
        if chain.len() == 1 && before.issuers.contains(&own.issuer) && !own.is_self_issued() {
            return Err(TlsError::NoIssuer { path: path() });
        }
        Ok(())
    }

    /// Reads the private key's file, if it is not open to everybody. Groups of users that may read keys are usual.
    fn key_file(&self) -> Result<Vec<u8>, TlsError> {
        let unreadable = |source| TlsError::Read { setting: "tls_key", path: self.key.clone(), source };
        let mut file = File::open(&self.key).map_err(unreadable)?;
        let metadata = file.metadata().map_err(unreadable)?;
        let (mode, owner) = (metadata.permissions().mode() & 0o777, metadata.uid());
        if is_open_to_all(mode) {
            return Err(TlsError::Open { path: self.key.clone(), mode });
        }
        if !is_private(mode, owner) {
            let path = self.key.display();
            warn!("the private key {path} has permissions {mode:o}: its group can use it. Run chmod 600 {path}");
        }
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(unreadable)?;
        Ok(text)
    }

    /// Loads the content of the files, which replaces the certificate in use, if there is any. A certificate that is
    /// not valid yet is taken only at the start: a clock that is wrong then is often set right a little later, and
    /// there is no other certificate.
    fn load(&self, protocol: Protocol, before: Option<&InUse>) -> Result<InUse, TlsError> {
        let chain = Self::certificates("tls_certificate", &self.certificate)?;
        let own = chain.first().and_then(|own| certificate::facts(own));
        let own = own.ok_or_else(|| TlsError::Unreadable { path: self.certificate.clone() })?;
        match self.check_dates(&own) {
            Err(early @ TlsError::NotYetValid { .. }) if before.is_none() => {
                error!("clients refuse to connect: {early}");
            }
            checked => checked?,
        }
        self.check_use(&own, &chain, before)?;
        let config = Arc::new(self.handshakes(protocol, &chain)?);
        if let (Some(before), Some(first)) = (before, chain.first()) {
            before.report_lost_names(&own, first);
        }
        let issuers = chain.iter().skip(1).filter_map(|issuer| certificate::facts(issuer));
        Ok(InUse {
            config,
            issuers: issuers.map(|issuer| issuer.subject).collect(),
            first: chain.into_iter().next(),
            own,
        })
    }

    /// The settings of handshakes with these certificates.
    fn handshakes(&self, protocol: Protocol, chain: &[CertificateDer<'static>]) -> Result<ServerConfig, TlsError> {
        let key = PrivateKeyDer::from_pem_slice(&self.key_file()?);
        let missing = |_| TlsError::Missing {
            setting: "tls_key",
            path: self.key.clone(),
            what: "private key without a password",
        };
        let key = key.map_err(missing)?;
        let provider = Arc::new(ring::default_provider());
        let builder = ServerConfig::builder_with_provider(Arc::clone(&provider)).with_protocol_versions(&[&TLS13]);
        let builder = builder.map_err(TlsError::Pair)?;
        // Programs that read health and metrics have no certificate.
        let builder = match self.client_ca.as_ref().filter(|_| protocol == Protocol::Http2) {
            None => builder.with_no_client_auth(),
            Some(path) => {
                let wrong = |reason: String| TlsError::ClientCa { path: path.clone(), reason };
                let mut roots = RootCertStore::empty();
                for authority in Self::certificates("tls_client_ca", path)? {
                    roots.add(authority).map_err(|error| wrong(error.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
                builder.with_client_cert_verifier(verifier.map_err(|error| wrong(error.to_string()))?)
            }
        };
        let mut config = builder.with_single_cert(chain.to_vec(), key).map_err(TlsError::Pair)?;
        Self::report_end(chain);
        config.alpn_protocols = vec![match protocol {
            Protocol::Http2 => b"h2".to_vec(),
            Protocol::Http1 => b"http/1.1".to_vec(),
        }];
        Ok(config)
    }
}

fn read(setting: &'static str, path: &Path) -> Result<Vec<u8>, TlsError> {
    std::fs::read(path).map_err(|source| TlsError::Read { setting, path: path.to_owned(), source })
}

/// The certificate that a port uses.
struct InUse {
    config: Arc<ServerConfig>,
    first: Option<CertificateDer<'static>>,
    own: Facts,
    /// The names of the certificates after the own one, in DER.
    issuers: Vec<Vec<u8>>,
}

impl InUse {
    /// The names that another certificate is for as well: word by word, or by a wildcard of either.
    fn names_kept<'a>(
        &'a self,
        next: &'a Facts,
        first: &'a CertificateDer<'static>,
    ) -> impl Iterator<Item = &'a String> {
        let is_within = |name: &String| self.first.as_ref().is_some_and(|before| certificate::is_for(before, name));
        let is_kept = move |name: &&String| {
            next.names.contains(name)
                || certificate::is_for(first, name)
                || (name.starts_with("*.") && next.names.iter().any(is_within))
        };
        self.own.names.iter().filter(is_kept)
    }

    /// Logs the names that the next certificate is not for.
    fn report_lost_names(&self, next: &Facts, first: &CertificateDer<'static>) {
        let kept: Vec<&String> = self.names_kept(next, first).collect();
        let lost: Vec<&str> = self.own.names.iter().filter(|name| !kept.contains(name)).map(String::as_str).collect();
        if !lost.is_empty() {
            warn!("the new certificate is not for {}, as the one before was", lost.join(", "));
        }
    }
}

/// The TLS of a port, whose certificate can be replaced while it is served. Clones share it.
#[derive(Clone)]
pub struct Tls {
    files: Arc<TlsFiles>,
    protocol: Protocol,
    in_use: Arc<ArcSwap<InUse>>,
}

impl fmt::Debug for Tls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tls").field("files", &self.files).finish_non_exhaustive()
    }
}

impl Tls {
    /// Creates the TLS of a port.
    ///
    /// # Errors
    /// A file cannot be used.
    pub fn new(files: TlsFiles, protocol: Protocol) -> Result<Self, TlsError> {
        let in_use = Arc::new(ArcSwap::from_pointee(files.load(protocol, None)?));
        Ok(Self { files: Arc::new(files), protocol, in_use })
    }

    /// Reads the files again. New connections use them; open ones are not touched.
    ///
    /// # Errors
    /// A file cannot be used; the files that were in use before stay in use.
    pub fn reload(&self) -> Result<(), TlsError> {
        let before = self.in_use.load_full();
        self.in_use.store(Arc::new(self.files.load(self.protocol, Some(&before))?));
        Ok(())
    }

    /// A connection whose handshake begins when it is first used.
    pub fn accept(&self, socket: TcpStream, peer: SocketAddr) -> TlsSocket {
        let acceptor = TlsAcceptor::from(Arc::clone(&self.in_use.load().config));
        let accept = match self.protocol {
            Protocol::Http2 => acceptor.accept(socket),
            Protocol::Http1 => {
                acceptor.accept_with(socket, |session| session.set_buffer_limit(Some(HTTP_BUFFER_BYTES)))
            }
        };
        TlsSocket { peer, stage: Stage::Handshake(accept.into_fallible()) }
    }
}

/// A connection with TLS.
pub struct TlsSocket {
    peer: SocketAddr,
    stage: Stage,
}

enum Stage {
    Handshake(FallibleAccept<TcpStream>),
    Open(TlsStream<TcpStream>),
    /// The handshake failed, and the client has to read the alert.
    Refused(RefusedClient),
    Failed,
}

/// A connection whose handshake failed, until the client has read the reason.
struct RefusedClient {
    socket: TcpStream,
    error: io::Error,
    until: Pin<Box<Sleep>>,
    ignored: usize,
}

impl RefusedClient {
    /// Ends the daemon's side, and ignores the bytes of the client until it ends its own side: a client of TLS 1.3
    /// assumes that the handshake is over, and has sent its first request. Returns the error of the handshake.
    fn poll_end(&mut self, context: &mut Context<'_>) -> Poll<io::Error> {
        // A connection that is closed already has nothing to end.
        let _ = ready!(Pin::new(&mut self.socket).poll_shutdown(context));
        let mut bytes = [0; 8192];
        while self.ignored < REFUSED_BYTES && self.until.as_mut().poll(context).is_pending() {
            let mut buffer = ReadBuf::new(&mut bytes);
            let read = ready!(Pin::new(&mut self.socket).poll_read(context, &mut buffer));
            self.ignored += buffer.filled().len();
            if read.is_err() || buffer.filled().is_empty() {
                break;
            }
        }
        Poll::Ready(std::mem::replace(&mut self.error, io::ErrorKind::ConnectionAborted.into()))
    }
}

impl fmt::Debug for TlsSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.stage {
            Stage::Handshake(_) => "TlsSocket(handshake)",
            Stage::Open(_) => "TlsSocket(open)",
            Stage::Refused(_) => "TlsSocket(refused)",
            Stage::Failed => "TlsSocket(failed)",
        })
    }
}

impl TlsSocket {
    fn poll_open(&mut self, context: &mut Context<'_>) -> Poll<io::Result<Pin<&mut TlsStream<TcpStream>>>> {
        if let Stage::Handshake(accept) = &mut self.stage {
            self.stage = match ready!(Pin::new(accept).poll(context)) {
                Ok(stream) => Stage::Open(stream),
                Err((error, socket)) => {
                    if let Some(left_out) = FAILURES.next() {
                        info!(peer = %self.peer, %error, left_out, "a TLS handshake failed");
                    }
                    metrics::counter!("tidemap_tls_handshakes_failed_total").increment(1);
                    let until = Box::pin(sleep(REFUSED_LINGER));
                    Stage::Refused(RefusedClient { socket, error, until, ignored: 0 })
                }
            };
        }
        if let Stage::Refused(refusal) = &mut self.stage {
            let error = ready!(refusal.poll_end(context));
            self.stage = Stage::Failed;
            return Poll::Ready(Err(error));
        }
        Poll::Ready(match &mut self.stage {
            Stage::Open(stream) => Ok(Pin::new(stream)),
            Stage::Handshake(_) | Stage::Refused(_) | Stage::Failed => Err(io::ErrorKind::ConnectionAborted.into()),
        })
    }
}

impl AsyncRead for TlsSocket {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        ready!(self.poll_open(context))?.poll_read(context, buffer)
    }
}

impl AsyncWrite for TlsSocket {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        ready!(self.poll_open(context))?.poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        ready!(self.poll_open(context))?.poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.poll_open(context))?.poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match &mut self.stage {
            Stage::Open(stream) => Pin::new(stream).poll_shutdown(context),
            // Nothing was sent yet that has to be ended.
            Stage::Handshake(_) | Stage::Refused(_) | Stage::Failed => Poll::Ready(Ok(())),
        }
    }
}
