//! Callers with tokens: which maps they hear of.

use std::{io::Write as _, os::unix::fs::OpenOptionsExt as _};

use super::*;
use crate::access::keyring::Keyring;

/// A token for the map `lab` alone.
const TOKEN: &str = "tm_0a_secret";

/// A daemon that asks for tokens.
async fn member(name: &str) -> Member {
    let dir = tempfile::tempdir().expect("temporary folder");
    let hash = ring::digest::digest(&ring::digest::SHA256, TOKEN.as_bytes());
    let hash: String = hash.as_ref().iter().map(|byte| format!("{byte:02x}")).collect();
    let path = dir.path().join("tokens.toml");
    let mut file = std::fs::File::options().write(true).create(true).mode(0o600).open(&path).expect("a file");
    writeln!(file, "[[token]]\nid = '0a'\nsha256 = '{hash}'\nroles = ['operator']\nmaps = ['lab']").expect("written");
    let access = Access::Tokens(Keyring::open(path).expect("tokens"));
    Member::start_in(name, dir, u64::MAX, access).await.0
}

impl Member {
    /// What is said to the holder of the token who lists the states of a map.
    async fn refusal(&self, map: &str) -> Status {
        let mut request = tonic::Request::new(v1::ListStatesRequest { map: map.to_owned(), ..Default::default() });
        request.metadata_mut().insert("authorization", format!("Bearer {TOKEN}").parse().expect("a value"));
        self.maps().await.list_states(request).await.expect_err("no answer")
    }
}

#[tokio::test]
async fn a_token_for_other_maps_does_not_hear_how_a_map_is_doing() {
    let a = member("a").await;
    a.create().await;
    a.tell(ReplicaEvent::Following { writer: None }).await;
    *a.known.heard.lock().expect("not poisoned") = None;
    for map in ["office", "no-map"] {
        assert_eq!(reason(&a.refusal(map).await), (Code::PermissionDenied, "NOT_FOR_MAP".to_owned()), "{map}");
    }
}
