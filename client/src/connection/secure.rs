//! Connections with TLS.
//!
//! With TLS 1.3 a client ends its handshake before the daemon has checked the client's certificate. So a connection
//! counts as open only when the daemon has sent its first bytes: either HTTP/2 begins, or an alert has the reason why
//! not, which HTTP/2 would lose.
//!
//! Invariant: HTTP/2 reads the bytes that were read here again, whole and in order.

use std::{
    fmt,
    future::Future,
    io::{self, Cursor},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use hyper_util::{client::legacy::connect::HttpConnector, rt::TokioIo};
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, AsyncWrite, ReadBuf},
    net::TcpStream,
};
use tokio_rustls::{
    TlsConnector,
    client::TlsStream,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject as _},
    },
};
use tonic::codegen::{Service, http::Uri};

use crate::error::Error;

/// The time limit of the daemon from the first byte of the handshake to the first byte of HTTP/2.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(5);
/// The frames with which HTTP/2 begins are shorter.
const FIRST_BYTES: usize = 4096;
/// The name of HTTP/2 in a handshake.
const HTTP2: &[u8] = b"h2";

type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// Opens connections with TLS.
#[derive(Clone)]
pub(super) struct SecureConnector {
    tcp: HttpConnector,
    tls: TlsConnector,
}

impl fmt::Debug for SecureConnector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SecureConnector")
    }
}

impl SecureConnector {
    /// A connector that trusts these authorities, and shows this certificate of the client with its private key, if
    /// there is one. All are in PEM form.
    ///
    /// # Errors
    /// [`Error::Tls`]: a certificate or the key cannot be read, or they do not fit.
    pub(super) fn new(ca: &[u8], identity: Option<&(Vec<u8>, Vec<u8>)>) -> Result<Self, Error> {
        let wrong = |what: &str, error: &dyn fmt::Display| Error::Tls(format!("{what}: {error}"));
        let mut roots = RootCertStore::empty();
        let authorities = CertificateDer::pem_slice_iter(ca).collect::<Result<Vec<_>, _>>();
        let authorities = authorities.map_err(|error| wrong("the file of authorities", &error))?;
        // A file of many authorities may have some that rustls cannot use.
        if roots.add_parsable_certificates(authorities).0 == 0 {
            return Err(Error::Tls("the file of authorities holds no certificate that can be used".to_owned()));
        }
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let config = config.with_safe_default_protocol_versions().map_err(|error| wrong("the versions", &error))?;
        let config = config.with_root_certificates(roots);
        let mut config = match identity {
            None => config.with_no_client_auth(),
            Some((certificate, key)) => {
                let chain = CertificateDer::pem_slice_iter(certificate).collect::<Result<Vec<_>, _>>();
                let chain = chain.map_err(|error| wrong("the certificate of the client", &error))?;
                let key = PrivateKeyDer::from_pem_slice(key);
                let key = key.map_err(|error| wrong("the private key of the client", &error))?;
                let config = config.with_client_auth_cert(chain, key);
                config.map_err(|error| wrong("the certificate of the client and its private key", &error))?
            }
        };
        config.alpn_protocols.push(HTTP2.to_vec());
        let mut tcp = HttpConnector::new();
        tcp.set_nodelay(true);
        Ok(Self { tcp, tls: TlsConnector::from(Arc::new(config)) })
    }

    async fn open(mut self, uri: Uri) -> Result<SecureStream, BoxError> {
        let host = uri.host().unwrap_or_default().trim_start_matches('[').trim_end_matches(']').to_owned();
        let name = ServerName::try_from(host)?;
        let stream = self.tcp.call(uri).await?.into_inner();
        let handshake = async {
            let mut stream = self.tls.connect(name, stream).await?;
            if stream.get_ref().1.alpn_protocol() != Some(HTTP2) {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "the other side does not use HTTP/2"));
            }
            let mut first = vec![0; FIRST_BYTES];
            let count = stream.read(&mut first).await?;
            if count == 0 {
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the daemon closed the connection"));
            }
            first.truncate(count);
            Ok(SecureStream { first: Cursor::new(first), stream })
        };
        let late = || io::Error::new(io::ErrorKind::TimedOut, "the handshake of TLS took too long");
        Ok(tokio::time::timeout(HANDSHAKE_WITHIN, handshake).await.map_err(|_| late())??)
    }
}

impl Service<Uri> for SecureConnector {
    type Response = TokioIo<SecureStream>;
    type Error = BoxError;
    type Future = Pin<Box<dyn Future<Output = Result<TokioIo<SecureStream>, BoxError>> + Send>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), BoxError>> {
        self.tcp.poll_ready(cx).map_err(Into::into)
    }

    fn call(&mut self, uri: Uri) -> Self::Future {
        let connector = self.clone();
        Box::pin(async move { connector.open(uri).await.map(TokioIo::new) })
    }
}

/// A connection, with the bytes that were already read from it.
#[derive(Debug)]
pub(super) struct SecureStream {
    first: Cursor<Vec<u8>>,
    stream: TlsStream<TcpStream>,
}

impl AsyncRead for SecureStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        if self.first.position() < self.first.get_ref().len() as u64 {
            return Pin::new(&mut self.first).poll_read(cx, buffer);
        }
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for SecureStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(cx, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
