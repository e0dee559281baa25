//! Certificates for tests, made anew by each test: authorities, and the certificates that they sign for daemons and
//! clients.
//!
//! Invariant: a certificate names this machine (`localhost`, 127.0.0.1) where no other names are given, and its files
//! are its owner's alone.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};
use tidemap_client::{Client, connection::Credentials};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore, SupportedProtocolVersion,
        crypto::ring,
        pki_types::{CertificateDer, pem::PemObject as _},
    },
};

use crate::daemon::Daemon;

/// An authority.
#[derive(Debug)]
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

/// A certificate and its private key, in PEM form.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The certificate.
    pub certificate: String,
    /// The private key.
    pub key: String,
}

/// When a certificate is valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// For years.
    Years,
    /// The certificate ended years ago.
    Ended,
    /// The certificate begins in a century.
    NotYet,
}

/// The side of a connection that a certificate is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Servers and clients.
    Both,
    /// Clients only.
    Clients,
}

/// The parameters and the key of an authority of a name.
fn authority(name: &str) -> (CertificateParams, KeyPair) {
    let mut params = CertificateParams::new(Vec::<String>::new()).expect("parameters");
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    (params, KeyPair::generate().expect("a key"))
}

impl Authority {
    /// A new one.
    ///
    /// # Panics
    /// If the certificate cannot be made.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let (params, key) = authority(name);
        let pem = params.self_signed(&key).expect("a certificate").pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// An authority between this one and a daemon.
    ///
    /// # Panics
    /// If the certificate cannot be made.
    #[must_use]
    pub fn below(&self, name: &str) -> Self {
        let (params, key) = authority(name);
        let pem = params.signed_by(&key, &self.issuer).expect("a certificate").pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// The certificate of the authority, in PEM format.
    #[must_use]
    pub fn pem(&self) -> &str {
        &self.pem
    }

    /// A certificate for this machine, good for both sides of a connection.
    ///
    /// # Panics
    /// If it cannot be made.
    #[must_use]
    pub fn sign(&self, validity: Validity) -> Pair {
        self.sign_for(validity, &["localhost", "127.0.0.1"], Purpose::Both)
    }

    /// A certificate for these names and addresses, and for this side of a connection.
    ///
    /// # Panics
    /// If it cannot be made.
    #[must_use]
    pub fn sign_for(&self, validity: Validity, names: &[&str], purpose: Purpose) -> Pair {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let mut params = CertificateParams::new(names).expect("parameters");
        params.extended_key_usages = match purpose {
            Purpose::Both => vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth],
            Purpose::Clients => vec![ExtendedKeyUsagePurpose::ClientAuth],
        };
        let years = match validity {
            Validity::Years => (2020, 2120),
            Validity::Ended => (2019, 2020),
            Validity::NotYet => (2120, 2130),
        };
        (params.not_before, params.not_after) = (date_time_ymd(years.0, 1, 1), date_time_ymd(years.1, 1, 1));
        let key = KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &self.issuer).expect("a certificate").pem();
        Pair { certificate, key: key.serialize_pem() }
    }

    /// Returns a connector that opens TLS connections of this version to those who have a certificate of this
    /// authority.
    ///
    /// # Panics
    /// If TLS cannot be set up.
    #[must_use]
    pub fn connector(&self, version: &'static SupportedProtocolVersion) -> TlsConnector {
        let mut roots = RootCertStore::empty();
        roots.add(CertificateDer::from_pem_slice(self.pem().as_bytes()).expect("PEM")).expect("a certificate");
        let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let builder = builder.with_protocol_versions(&[version]).expect("a version");
        let mut config = builder.with_root_certificates(roots).with_no_client_auth();
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        TlsConnector::from(Arc::new(config))
    }

    /// A client of a daemon with TLS, that trusts this authority and presents a certificate, if there is one.
    ///
    /// # Panics
    /// If the certificates cannot be used.
    #[must_use]
    pub fn client(&self, daemon: &Daemon, own: Option<&Pair>, token: Option<&str>) -> Client {
        let identity = own.map(|pair| (pair.certificate.clone().into_bytes(), pair.key.clone().into_bytes()));
        let credentials =
            Credentials { token: token.map(str::to_owned), ca: Some(self.pem.clone().into_bytes()), identity };
        Client::with_credentials(&format!("https://{}", daemon.grpc), &credentials).expect("certificates")
    }
}

impl Pair {
    /// This certificate with that of an authority behind it in the file.
    #[must_use]
    pub fn with(mut self, issuer: &Authority) -> Self {
        self.certificate.push_str(&issuer.pem);
        self
    }

    /// Writes it to `daemon.pem` and `daemon.key` of a folder.
    ///
    /// # Panics
    /// If the folder cannot be written.
    #[must_use = "the paths of the certificate and of the key"]
    pub fn write(&self, folder: &Path) -> [PathBuf; 2] {
        [
            private_file(&folder.join("daemon.pem"), &self.certificate),
            private_file(&folder.join("daemon.key"), &self.key),
        ]
    }
}

/// Puts a text into a file of permissions 0600, in one step; returns its path.
///
/// # Panics
/// If the folder cannot be written.
pub fn private_file(path: &Path, text: &str) -> PathBuf {
    let new = path.with_extension("new");
    fs::write(&new, text).expect("written");
    fs::set_permissions(&new, fs::Permissions::from_mode(0o600)).expect("permissions");
    fs::rename(&new, path).expect("renamed");
    path.to_owned()
}
