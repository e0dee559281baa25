//! The content of a certificate of the daemon: its period, its purpose, its host names, and its issuer.
//!
//! Invariant: this module refuses only certificates that clients would refuse. Clients judge what is not known here,
//! such as the authorities that they trust.

use std::{fmt, net::IpAddr};

use tokio_rustls::rustls::{
    CertificateError, Error, RootCertStore,
    client::{verify_server_cert_signed_by_trust_anchor, verify_server_name},
    crypto::ring,
    pki_types::{CertificateDer, ServerName, UnixTime},
    server::ParsedCertificate,
};
use x509_parser::{extensions::GeneralName, prelude::FromDer as _};

/// The data that is read from a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// The first second in which the certificate is valid, since 1970.
    pub from_secs: i64,
    /// The last second in which it is valid.
    pub until_secs: i64,
    /// The names and addresses of hosts that the certificate is for, in its order.
    pub names: Vec<String>,
    /// The reason why no server may use the certificate, if none may.
    pub not_for_servers: Option<NotForServers>,
    /// The distinguished name of the certificate, in DER.
    pub subject: Vec<u8>,
    /// The distinguished name of the issuer, in DER.
    pub issuer: Vec<u8>,
}

/// The reason why no server may use a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotForServers {
    /// The extended key usage names other uses.
    Purpose,
    /// The key usage does not allow signatures, which TLS 1.3 needs.
    Signature,
}

impl fmt::Display for NotForServers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Purpose => "its extended key usage does not have serverAuth, as that of a certificate for clients",
            Self::Signature => "its key usage does not have digitalSignature",
        })
    }
}

/// Reads a certificate; `None`: the bytes are no certificate.
pub(super) fn facts(certificate: &[u8]) -> Option<Facts> {
    let (_, read) = x509_parser::certificate::X509Certificate::from_der(certificate).ok()?;
    let names = read.subject_alternative_name().ok()?.map(|found| found.value.general_names.iter().filter_map(host));
    let purpose = read.extended_key_usage().ok()?.map(|found| found.value.any || found.value.server_auth);
    let signs = read.key_usage().ok()?.map(|found| found.value.digital_signature());
    Some(Facts {
        from_secs: read.validity().not_before.timestamp(),
        until_secs: read.validity().not_after.timestamp(),
        names: names.map(Iterator::collect).unwrap_or_default(),
        not_for_servers: match (purpose, signs) {
            (Some(false), _) => Some(NotForServers::Purpose),
            (_, Some(false)) => Some(NotForServers::Signature),
            _ => None,
        },
        subject: read.subject().as_raw().to_owned(),
        issuer: read.issuer().as_raw().to_owned(),
    })
}

/// The name or address of a host.
fn host(name: &GeneralName<'_>) -> Option<String> {
    match name {
        GeneralName::DNSName(name) => Some((*name).to_owned()),
        GeneralName::IPAddress(bytes) => {
            let four = <[u8; 4]>::try_from(*bytes).map(IpAddr::from);
            let address = four.or_else(|_| <[u8; 16]>::try_from(*bytes).map(IpAddr::from));
            address.ok().map(|address| address.to_string())
        }
        _ => None,
    }
}

impl Facts {
    /// Whether the certificate is signed by its own key, or by a key of the same name.
    pub(super) fn is_self_issued(&self) -> bool {
        self.subject == self.issuer
    }
}

/// Whether a certificate is for a host. A text that is no name of a host is used by no client.
pub(super) fn is_for(certificate: &CertificateDer<'_>, host: &str) -> bool {
    let (Ok(parsed), Ok(name)) = (ParsedCertificate::try_from(certificate), ServerName::try_from(host)) else {
        return false;
    };
    verify_server_name(&parsed, &name).is_ok()
}

/// Whether one of the certificates after the first in a file has signed the first. `at_secs`: a time at which it is
/// valid.
pub(super) fn is_signed_within(chain: &[CertificateDer<'static>], at_secs: i64) -> bool {
    let Some((own, others)) = chain.split_first() else { return false };
    let Ok(parsed) = ParsedCertificate::try_from(own) else { return false };
    let mut issuers = RootCertStore::empty();
    issuers.add_parsable_certificates(others.iter().cloned());
    let at = UnixTime::since_unix_epoch(std::time::Duration::from_secs(at_secs.max(0).unsigned_abs()));
    let algorithms = ring::default_provider().signature_verification_algorithms.all;
    let checked = verify_server_cert_signed_by_trust_anchor(&parsed, &issuers, others, at, algorithms);
    // Other errors, for example about an algorithm that is not known here, may be no error for a client.
    !matches!(checked, Err(Error::InvalidCertificate(CertificateError::UnknownIssuer | CertificateError::BadSignature)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_certificate_has_no_facts() {
        // These are the beginning of a certificate, and bytes that are no certificate.
        for bytes in [&b""[..], b"\x30", b"\x30\x82\x01\x00\x30\x03\x02\x01\x01", &[0xff; 300]] {
            assert_eq!(facts(bytes), None);
            assert!(!is_for(&CertificateDer::from(bytes), "localhost"));
        }
    }

    #[test]
    fn hosts_are_names_and_addresses() {
        assert_eq!(host(&GeneralName::DNSName("*.example.org")).as_deref(), Some("*.example.org"));
        assert_eq!(host(&GeneralName::IPAddress(&[127, 0, 0, 1])).as_deref(), Some("127.0.0.1"));
        let six = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];
        assert_eq!(host(&GeneralName::IPAddress(&six)).as_deref(), Some("::1"));
        assert_eq!(host(&GeneralName::IPAddress(&[1, 2, 3])), None);
        assert_eq!(host(&GeneralName::URI("spiffe://example.org/robot")), None);
    }
}
