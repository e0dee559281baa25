//! Failed traversals are read as they were written.

use tidemap_map::{name::EdgeName, site::Site, traversal::EdgeFailure};

use crate::record;

#[test]
fn failed_traversals_come_back_in_their_order() {
    let mut site = Site::default();
    let edge = EdgeName::new("a", "b", "").expect("valid");
    let failure = |start_nanos, reason: &str| EdgeFailure {
        edge: edge.clone(),
        start_nanos,
        end_nanos: start_nanos + 5,
        reason: reason.to_owned(),
    };
    site.add_failures(&[failure(7, "late"), failure(3, "early"), failure(7, "later")]);
    let message = record::site::encode(&site).expect("something was told");
    assert_eq!(record::site::decode(&message, 0).expect("readable"), site);
    for spoil in
        [(|failure| failure.from = "a/b".to_owned()) as fn(&mut tidemap_migrations::v1::site::EdgeFailure), |failure| {
            failure.reason = "x".repeat(201);
        }]
    {
        let mut broken = message.clone();
        spoil(&mut broken.failures[1]);
        assert!(record::site::decode(&broken, 0).is_err());
    }
}
