//! Certificates for tests, made anew by each test: authorities, and what they sign for daemons and clients.
//!
//! Invariant: a certificate names this machine (`localhost`, 127.0.0.1), and its files are its owner's alone.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
};

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};
use tidemap_client::{Client, connection::Credentials};

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
    /// It ended years ago.
    Ended,
    /// It begins in a century.
    NotYet,
}

impl Authority {
    /// A new one.
    ///
    /// # Panics
    /// If the certificate cannot be made.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::<String>::new()).expect("parameters");
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
        let key = KeyPair::generate().expect("a key");
        let pem = params.self_signed(&key).expect("a certificate").pem();
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
        let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
        let mut params = CertificateParams::new(names).expect("parameters");
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
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
