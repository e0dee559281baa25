//! Acknowledgements in messages that every client accepts.
//!
//! Invariant: a refusal is sent before or with an acknowledgement of its sequence number, never after it.

use tidemap_ingest::protocol::RefusedObservation;
use tidemap_proto::{convert::map::refused_to_wire, v1};

/// Maximum number of refusals of one message: less than 1 MB; clients accept 4 MiB.
const REFUSALS_MAX: usize = 1000;

/// The messages that acknowledge the sequence numbers after `before` up to `durable`, at a log position. All messages
/// but the last repeat the old number, so that a client that receives only some of them does not take refused
/// observations for accepted.
pub(super) fn acks(
    (before, durable): (u64, u64),
    refused: Vec<RefusedObservation>,
    position: u64,
) -> impl Iterator<Item = v1::Ack> {
    let mut left = refused.len();
    let mut refused = refused.into_iter();
    let mut is_first = true;
    std::iter::from_fn(move || {
        if left == 0 && !is_first {
            return None;
        }
        is_first = false;
        let refused: Vec<_> = refused.by_ref().take(REFUSALS_MAX).map(refusal_to_wire).collect();
        left -= refused.len();
        Some(v1::Ack { durable_sequence: if left == 0 { durable } else { before }, refused, position })
    })
}

/// A refused observation, for the wire.
pub(super) fn refusal_to_wire(RefusedObservation { sequence, reason, detail }: RefusedObservation) -> v1::Refusal {
    refused_to_wire(sequence, reason, detail)
}

#[cfg(test)]
mod tests {
    use tidemap_map::ids::RefusalReason;

    use super::*;

    fn check(count: u64, expected: &[(u64, usize)]) {
        let refused =
            |sequence| RefusedObservation { sequence, reason: RefusalReason::Value, detail: "wrong".to_owned() };
        let acks: Vec<_> = acks((7, 9000), (8..8 + count).map(refused).collect(), 5).collect();
        let shape: Vec<_> = acks.iter().map(|ack| (ack.durable_sequence, ack.refused.len())).collect();
        assert_eq!(shape, expected);
        let refused = acks.iter().flat_map(|ack| &ack.refused).map(|refusal| refusal.sequence);
        assert!(refused.eq(8..8 + count));
    }

    #[test]
    fn many_refusals_are_reported_before_their_number_is_durable() {
        check(0, &[(9000, 0)]);
        check(1000, &[(9000, 1000)]);
        check(1001, &[(7, 1000), (9000, 1)]);
        check(3000, &[(7, 1000), (7, 1000), (9000, 1000)]);
    }
}
