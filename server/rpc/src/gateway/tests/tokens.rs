//! Callers with tokens: which maps they can see, and where their tokens go.

use std::{io::Write as _, os::unix::fs::OpenOptionsExt as _};

use tidemap_base::access::keyring::Keyring;

use super::*;

/// A token for the map `lab` alone.
const TOKEN: &str = "tm_0a_secret";

/// A daemon that requires tokens.
async fn member(name: &str) -> Member {
    let dir = tempfile::tempdir().expect("temporary folder");
    let hash = ring::digest::digest(&ring::digest::SHA256, TOKEN.as_bytes());
    let hash: String = hash.as_ref().iter().map(|byte| format!("{byte:02x}")).collect();
    let path = dir.path().join("tokens.toml");
    let mut file = std::fs::File::options().write(true).create_new(true).mode(0o600).open(&path).expect("a file");
    writeln!(file, "[[token]]\nid = '0a'\nsha256 = '{hash}'\nroles = ['operator']\nmaps = ['lab']").expect("written");
    let access = Access::Tokens(Keyring::open(path).expect("tokens"));
    Member::start_in(name, dir, u64::MAX, access).await.0
}

impl Member {
    /// The error for the holder of the token who lists the states of a map.
    async fn refusal(&self, map: &str) -> Status {
        let mut request = tonic::Request::new(v1::ListStatesRequest { map: map.to_owned(), ..Default::default() });
        request.metadata_mut().insert("authorization", format!("Bearer {TOKEN}").parse().expect("a value"));
        self.maps().await.list_states(request).await.expect_err("no answer")
    }
}

#[tokio::test]
async fn a_token_for_other_maps_does_not_show_the_condition_of_a_map() {
    let a = member("a").await;
    a.create().await;
    a.notify(ReplicaEvent::Following { writer: None }).await;
    *a.known.last_contact.lock().expect("not poisoned") = None;
    for map in ["office", "no-map"] {
        assert_eq!(reason(&a.refusal(map).await), (Code::PermissionDenied, "NOT_FOR_MAP".to_owned()), "{map}");
    }
}

#[tokio::test]
async fn a_token_does_not_go_over_a_network_without_tls() {
    let a = member("a").await;
    a.known.writers.lock().expect("not poisoned").insert("lab".to_owned(), "b".to_owned());
    // The address belongs to nobody: a daemon that tried it would report that it does not answer.
    for (address, words) in [
        ("http://192.0.2.1:7435", "a token is not sent to http://192.0.2.1:7435 without TLS"),
        ("HTTP://192.0.2.1:7435", "a token is not sent"),
        ("http://127.0.0.1.example.org:7435", "a token is not sent"),
        ("http://localhost:1@192.0.2.1:7435", "a token is not sent"),
        ("https://192.0.2.1:7435", "cluster.peer_ca"),
    ] {
        a.knows("b", address);
        let refused = a.refusal("lab").await;
        assert_eq!(reason(&refused), (Code::Unavailable, "UNREACHABLE".to_owned()), "{refused:?}");
        assert!(refused.message().contains(words), "{refused:?}");
    }
    let b = Member::start("b").await;
    a.knows("b", &b.address);
    let refused = a.refusal("lab").await;
    assert_eq!(reason(&refused), (Code::NotFound, "UNKNOWN_MAP".to_owned()), "it goes to a daemon on this machine");
}
