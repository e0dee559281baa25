//! TLS of connections: TLS 1.3 only, with the daemon's certificate and, where an authority is named, a certificate of
//! the client.
//!
//! Invariant: the handshake is driven by the first read or write, so that the deadline of a connection's first request
//! covers it. A certificate that cannot be used, or that clients would not take now, never takes the place of one that
//! can. Errors name files, and never hold what is in them.

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
};

use arc_swap::ArcSwap;
use tidemap_model::time::format_rfc3339;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::TcpStream,
};
use tokio_rustls::{
    Accept, TlsAcceptor,
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

use super::{validity, validity::Validity};
use crate::{
    clock::{Clock as _, SystemClock},
    secret_file::{is_open_to_all, is_private},
    telemetry::occasional::Occasional,
};

/// Which protocol a port speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// HTTP/2 with prior knowledge, as gRPC.
    Http2,
    /// HTTP/1.
    Http1,
}

static FAILURES: Occasional = Occasional::new();

/// The files of the daemon's TLS, in PEM form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TlsFiles {
    /// The daemon's certificate, followed by those of the authorities between it and the root.
    pub certificate: PathBuf,
    /// The private key of the daemon's certificate.
    pub key: PathBuf,
    /// Authorities of clients; if named, each client must present a certificate of one of them.
    pub client_ca: Option<PathBuf>,
}

/// Why files of TLS cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TlsError {
    #[error("setting {setting}: {} cannot be read: {source}", .path.display())]
    Read { setting: &'static str, path: PathBuf, source: io::Error },
    #[error("setting {setting}: {} holds no {what} in PEM form", .path.display())]
    Missing { setting: &'static str, path: PathBuf, what: &'static str },
    #[error(
        "setting tls_key: {} has permissions {mode:o}, so that everybody on this machine can read or change the key. \
         Say chmod 600 {}",
        .path.display(), .path.display()
    )]
    Open { path: PathBuf, mode: u32 },
    #[error(
        "setting tls_certificate: the certificate in {} has expired, it was valid until {}. Put a new one in its place",
        .path.display(), shown(*.until_secs)
    )]
    Expired { path: PathBuf, until_secs: i64 },
    #[error(
        "setting tls_certificate: the certificate in {} is not valid before {}, and this machine's clock says {}. Set \
         the clock, or wait",
        .path.display(), shown(*.from_secs), shown(*.now_secs)
    )]
    NotYetValid { path: PathBuf, from_secs: i64, now_secs: i64 },
    #[error("settings tls_certificate and tls_key cannot be used together: {0}")]
    Pair(rustls::Error),
    #[error("setting tls_client_ca: {} cannot be used: {reason}", .path.display())]
    ClientCa { path: PathBuf, reason: String },
}

/// A time in seconds since 1970, for people.
fn shown(secs: i64) -> String {
    format_rfc3339(secs.saturating_mul(1_000_000_000))
}

impl TlsFiles {
    /// The files, to be followed.
    pub(crate) fn paths(&self) -> Vec<PathBuf> {
        [&self.certificate, &self.key].into_iter().chain(&self.client_ca).cloned().collect()
    }

    fn certificates(setting: &'static str, path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
        let text = read(setting, path)?;
        let found = CertificateDer::pem_slice_iter(&text).collect::<Result<Vec<_>, _>>();
        let missing = || TlsError::Missing { setting, path: path.to_owned(), what: "certificate" };
        found.ok().filter(|found| !found.is_empty()).ok_or_else(missing)
    }

    /// Tells by when the daemon's certificate has to be replaced: when it, or one behind it in the file, ends.
    fn tell_end(chain: &[CertificateDer<'static>]) {
        let ends = chain.iter().filter_map(|certificate| validity::validity(certificate)).map(|valid| valid.until_secs);
        if let Some(ends_secs) = ends.min() {
            metrics::gauge!("tidemap_certificate_expiry_seconds").set(ends_secs as f64);
        }
    }

    /// Whether clients can take the daemon's own certificate now. Those behind it in the file may not be needed.
    fn check_dates(&self, chain: &[CertificateDer<'static>]) -> Result<(), TlsError> {
        let now_secs = SystemClock.now_nanos().div_euclid(1_000_000_000);
        let path = || self.certificate.clone();
        match chain.first().and_then(|own| validity::validity(own)) {
            Some(Validity { until_secs, .. }) if until_secs < now_secs => {
                Err(TlsError::Expired { path: path(), until_secs })
            }
            Some(Validity { from_secs, .. }) if from_secs > now_secs => {
                Err(TlsError::NotYetValid { path: path(), from_secs, now_secs })
            }
            _ => Ok(()),
        }
    }

    /// The private key's file, if it is not open to everybody. Groups of users that may read keys are usual.
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
            warn!("the private key {path} has permissions {mode:o}: its group can use it. Say chmod 600 {path}");
        }
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(unreadable)?;
        Ok(text)
    }

    /// The settings of handshakes. A certificate that is not valid yet is taken only at the start: a clock that is
    /// wrong then is often set right a little later, and there is no other certificate.
    fn load(&self, protocol: Protocol, is_start: bool) -> Result<ServerConfig, TlsError> {
        let chain = Self::certificates("tls_certificate", &self.certificate)?;
        match self.check_dates(&chain) {
            Err(early @ TlsError::NotYetValid { .. }) if is_start => error!("clients refuse to connect: {early}"),
            checked => checked?,
        }
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
        // Health and metrics are asked for by programs that have no certificate.
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
        let mut config = builder.with_single_cert(chain.clone(), key).map_err(TlsError::Pair)?;
        Self::tell_end(&chain);
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

/// The TLS of a port, whose certificate can be replaced while it is served. Clones share it.
#[derive(Clone)]
pub(crate) struct Tls {
    files: Arc<TlsFiles>,
    protocol: Protocol,
    config: Arc<ArcSwap<ServerConfig>>,
}

impl fmt::Debug for Tls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tls").field("files", &self.files).finish_non_exhaustive()
    }
}

impl Tls {
    /// The TLS of a port.
    ///
    /// # Errors
    /// A file that cannot be used.
    pub(crate) fn new(files: TlsFiles, protocol: Protocol) -> Result<Self, TlsError> {
        let config = Arc::new(ArcSwap::from_pointee(files.load(protocol, true)?));
        Ok(Self { files: Arc::new(files), protocol, config })
    }

    /// Reads the files again. New connections use them; open ones are not touched.
    ///
    /// # Errors
    /// A file that cannot be used; what was in use before stays.
    pub(crate) fn reload(&self) -> Result<(), TlsError> {
        self.config.store(Arc::new(self.files.load(self.protocol, false)?));
        Ok(())
    }

    /// A connection whose handshake begins with its first use.
    pub(crate) fn accept(&self, socket: TcpStream, peer: SocketAddr) -> TlsSocket {
        let acceptor = TlsAcceptor::from(self.config.load_full());
        TlsSocket { peer, stage: Stage::Handshake(acceptor.accept(socket)) }
    }
}

/// A connection with TLS.
pub(crate) struct TlsSocket {
    peer: SocketAddr,
    stage: Stage,
}

enum Stage {
    Handshake(Accept<TcpStream>),
    Open(TlsStream<TcpStream>),
    Failed,
}

impl fmt::Debug for TlsSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.stage {
            Stage::Handshake(_) => "TlsSocket(handshake)",
            Stage::Open(_) => "TlsSocket(open)",
            Stage::Failed => "TlsSocket(failed)",
        })
    }
}

impl TlsSocket {
    fn poll_open(&mut self, context: &mut Context<'_>) -> Poll<io::Result<Pin<&mut TlsStream<TcpStream>>>> {
        if let Stage::Handshake(accept) = &mut self.stage {
            self.stage = match ready!(Pin::new(accept).poll(context)) {
                Ok(stream) => Stage::Open(stream),
                Err(error) => {
                    if let Some(left_out) = FAILURES.next() {
                        info!(peer = %self.peer, %error, left_out, "a TLS handshake failed");
                    }
                    metrics::counter!("tidemap_tls_handshakes_failed_total").increment(1);
                    self.stage = Stage::Failed;
                    return Poll::Ready(Err(error));
                }
            };
        }
        Poll::Ready(match &mut self.stage {
            Stage::Open(stream) => Ok(Pin::new(stream)),
            Stage::Handshake(_) | Stage::Failed => Err(io::ErrorKind::ConnectionAborted.into()),
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
            // Nothing was said yet that has to be ended.
            Stage::Handshake(_) | Stage::Failed => Poll::Ready(Ok(())),
        }
    }
}
