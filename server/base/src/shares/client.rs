//! A client that takes shares: the holder of a token, or an address that shows none.
//!
//! A daemon of a cluster passes requests on for many clients. A client with a token is identified by it. For a client
//! without, the daemon names the client's address, and proves by the secret of the cluster that it has written the name
//! itself.
//!
//! Invariant: nobody outside of the cluster can name a client other than itself. The proof reveals nothing of the
//! secret.

use std::{fmt, net::IpAddr, sync::Arc};

use axum::http::{HeaderMap, HeaderName, HeaderValue};

use crate::{
    access::{Caller, peer_secret::PeerSecret},
    connections::Peer,
};

/// The header with the address of the client for which a daemon passes a request on, and the proof.
const PASSED_FOR: HeaderName = HeaderName::from_static("tidemap-passed-for");

tokio::task_local! {
    /// The client of the request that the task works on.
    static CLIENT: Client;
}

/// A client, as shares count it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Client {
    /// The holder of the token with this id.
    Token(Arc<str>),
    /// All callers at an address without a token.
    Address(Peer),
}

impl fmt::Display for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Token(id) => write!(f, "token {id}"),
            Self::Address(peer) => peer.fmt(f),
        }
    }
}

impl Client {
    /// The client of a request of a caller, by its headers and the other end of its connection.
    pub fn of(caller: &Caller, headers: &HeaderMap, peer: Peer, secret: Option<&PeerSecret>) -> Self {
        match caller {
            Caller::Holder(token) => Self::Token(token.id.as_str().into()),
            _ => Self::Address(secret.and_then(|secret| passed_for(headers, secret)).unwrap_or(peer)),
        }
    }

    /// The client of the request that this task works on. A task that was spawned by the work on a request has no
    /// client, unless it was started with [`Client::scope`].
    pub fn current() -> Self {
        CLIENT.try_with(Clone::clone).unwrap_or(Self::Address(Peer::Local))
    }

    /// Does the work for this client.
    pub fn scope<F: Future>(self, work: F) -> impl Future<Output = F::Output> {
        CLIENT.scope(self, work)
    }

    /// Whether the client is a program of this machine that has no token.
    pub fn is_of_this_machine(&self) -> bool {
        matches!(self, Self::Address(peer) if peer.is_of_this_machine())
    }

    /// Name of the client, with which a map records who has introduced a producer; empty if the client has no share of
    /// its own.
    pub fn share_name(&self) -> String {
        if self.is_of_this_machine() { String::new() } else { self.to_string() }
    }

    /// Names this client in the headers of a request that is passed on. A name that the client had set there is
    /// removed.
    pub fn name_in(&self, headers: &mut HeaderMap, secret: Option<&PeerSecret>) {
        headers.remove(PASSED_FOR);
        if let (Self::Address(peer), Some(secret)) = (self, secret) {
            let name = match peer {
                Peer::Address(address) => address.to_string(),
                Peer::Local => IpAddr::from([127, 0, 0, 1]).to_string(),
            };
            let proof = secret.proof_of(&name);
            headers.extend(HeaderValue::from_str(&format!("{name} {proof}")).ok().map(|value| (PASSED_FOR, value)));
        }
    }
}

/// The address that another daemon has named.
fn passed_for(headers: &HeaderMap, secret: &PeerSecret) -> Option<Peer> {
    let (name, proof) = headers.get(PASSED_FOR)?.to_str().ok()?.split_once(' ')?;
    let address = name.parse().ok()?;
    secret.proves(name, proof).then_some(Peer::Address(address))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_of_the_cluster_names_the_client_and_nobody_else_does() {
        let secret = PeerSecret::new("0123abcd".to_owned());
        let gateway = Peer::Address([10, 0, 0, 9].into());
        let robot = Client::Address(Peer::Address([10, 0, 0, 1].into()));
        let client_of = |headers: &HeaderMap, secret| Client::of(&Caller::Anybody, headers, gateway, secret);
        let mut headers = HeaderMap::new();
        robot.name_in(&mut headers, Some(&secret));
        assert_eq!(client_of(&headers, Some(&secret)), robot);
        assert_eq!(client_of(&headers, None), Client::Address(gateway), "a daemon without a cluster believes nobody");
        let other = PeerSecret::new("another".to_owned());
        assert_eq!(client_of(&headers, Some(&other)), Client::Address(gateway));
        let text = headers[PASSED_FOR].to_str().expect("text").to_owned();
        for forged in [text.replace("10.0.0.1", "10.0.0.2"), "10.0.0.2".to_owned(), "10.0.0.2 00".to_owned()] {
            let headers = HeaderMap::from_iter([(PASSED_FOR, HeaderValue::from_str(&forged).expect("text"))]);
            assert_eq!(client_of(&headers, Some(&secret)), Client::Address(gateway), "{forged}");
        }
        // A name that the client sets itself is not passed on.
        Client::Token("id".into()).name_in(&mut headers, Some(&secret));
        assert!(headers.is_empty());
    }
}
