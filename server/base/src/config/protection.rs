//! The protection that is missing on a port that other machines can reach.
//!
//! Invariant: an address counts as reachable unless it can be shown to be of this machine only.

use std::net::{IpAddr, SocketAddr};

/// The missing protection of a port beyond this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissingProtection {
    Tls,
    Tokens,
    Both,
}

impl std::fmt::Display for MissingProtection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Tls => "TLS",
            Self::Tokens => "tokens",
            Self::Both => "TLS and tokens",
        })
    }
}

impl MissingProtection {
    /// The risk of the missing protection.
    pub fn consequence(self) -> &'static str {
        match self {
            Self::Tls => "the transmitted data and the tokens can be read and changed on the way",
            Self::Tokens => "everybody who reaches the port can read, write and delete all maps",
            Self::Both => {
                "everybody who reaches the port can read, write and delete all maps, and the transmitted data can be \
                 read"
            }
        }
    }

    pub(super) fn remedy(self) -> &'static str {
        match self {
            Self::Tls => "Set tls_certificate and tls_key",
            Self::Tokens => "Set tokens_file",
            Self::Both => "Set tls_certificate, tls_key and tokens_file",
        }
    }
}

/// Whether only this machine can reach an address.
pub fn is_local(address: &str) -> bool {
    match address.parse::<SocketAddr>() {
        Ok(parsed) => parsed.ip().is_loopback(),
        Err(_) => address.rsplit_once(':').is_some_and(|(host, port)| {
            host == "localhost" && port.parse::<u16>().is_ok()
                || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
        }),
    }
}
