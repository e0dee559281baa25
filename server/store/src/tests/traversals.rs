//! Failed traversals are read as they were written.

use tidemap_layout::site::FailedTraversals;
use tidemap_map::{name::EdgeName, site::Site, traversal::EdgeFailure};

use super::example::spoiled;
use crate::record::tables;

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
    let rows: Vec<_> = tables::rows(&site).collect();
    assert_eq!(tables::site(&rows, 0).expect("readable"), site);
    let spoil: [fn(&mut FailedTraversals); 2] =
        [|row| row.failures[1].from = "a/b".to_owned(), |row| row.failures[1].reason = "x".repeat(201)];
    for spoil in spoil {
        assert!(tables::site(&spoiled(&rows, 0, spoil), 0).is_err());
    }
}
