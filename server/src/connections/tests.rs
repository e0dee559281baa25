//! Who makes room, when the bounds of connections are reached.

use super::{
    request_scan::{Protocol, RequestScan},
    *,
};

fn address(last: u8) -> Peer {
    Peer::Address(IpAddr::from([10, 0, 0, last]))
}

fn is_displaced(slot: &ConnectionSlot) -> bool {
    slot.seat.is_displaced.load(Ordering::Acquire)
}

fn connections(port: Port, total: usize, per_client: usize) -> Connections {
    Connections::new(port, ConnectionLimits { total, per_client, idle_after: Duration::from_secs(60) })
}

/// A request, from its beginning to its end.
fn request(slot: &ConnectionSlot, is_served: bool) -> Busy {
    Remote(Arc::clone(&slot.seat)).busy(is_served)
}

#[test]
fn the_oldest_connection_of_which_no_request_was_served_makes_room() {
    let connections = connections(Port::Grpc, 3, 3);
    let busy = connections.admit(address(1)).expect("room");
    let long = request(&busy, false);
    let silent: Vec<ConnectionSlot> = (0..2).map(|_| connections.admit(address(2)).expect("room")).collect();
    drop(request(&silent[0], false));
    let newcomer = connections.admit(address(3)).expect("the oldest one that was refused makes room");
    assert_eq!([&busy, &silent[0], &silent[1], &newcomer].map(is_displaced), [false, true, false, false]);
    let next = connections.admit(address(3)).expect("the silent one makes room");
    assert!(is_displaced(&silent[1]));
    drop((request(&newcomer, true), request(&next, true)));
    assert!(connections.admit(address(4)).is_none(), "all others are in use");
    drop(long);
    assert!(connections.admit(address(4)).is_some());
    assert!(is_displaced(&busy), "its request has ended, and was not served");
}

#[test]
fn a_client_at_its_bound_displaces_only_its_own_connections() {
    let connections = connections(Port::Http, 10, 2);
    let other = connections.admit(address(1)).expect("room");
    let own: Vec<ConnectionSlot> = (0..2).map(|_| connections.admit(address(2)).expect("room")).collect();
    let third = connections.admit(address(2)).expect("its oldest makes room");
    assert_eq!([&other, &own[0], &own[1], &third].map(is_displaced), [false, true, false, false]);
    let _requests = [request(&own[1], true), request(&third, true)];
    assert!(connections.admit(address(2)).is_none(), "its others are busy");
    assert!(connections.admit(address(3)).is_some());
}

#[test]
fn each_connection_of_the_reserve_makes_room_for_the_next() {
    let connections = connections(Port::Probes, 2, 1);
    let first = connections.admit(address(1)).expect("room");
    let _requests = request(&first, true);
    let second = connections.admit(address(1)).expect("the first makes room, whatever it does");
    assert!(is_displaced(&first) && !is_displaced(&second));
    let third = connections.admit(address(2)).expect("room");
    assert!(connections.admit(address(3)).is_some());
    assert!(is_displaced(&second) && !is_displaced(&third));
}

#[test]
fn frames_of_requests_are_requests_and_pings_are_not() {
    let frame = |kind: u8, stream: u8, payload: &[u8]| {
        let length = u8::try_from(payload.len()).expect("short");
        [&[0, 0, length, kind, 0, 0, 0, 0, stream][..], payload].concat()
    };
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec();
    let (settings, ping, window) = (frame(4, 0, &[]), frame(6, 0, &[1; 8]), frame(8, 0, &[0, 0, 1, 0]));
    let silent = [preface, settings, window, ping.clone()].concat();
    let headers = frame(1, 1, b"method");
    // In pieces of every size, because a network cuts where it likes.
    for piece in 1..=silent.len() {
        let mut scan = RequestScan::new(Protocol::Http2);
        assert!(!silent.chunks(piece).any(|bytes| scan.sees_request(bytes)), "{piece}");
        let found: Vec<bool> = headers.chunks(piece).map(|bytes| scan.sees_request(bytes)).collect();
        assert_eq!(found.iter().filter(|found| **found).count(), 1, "{piece}");
        assert!(!scan.sees_request(&ping));
        assert!(!scan.sees_request(&frame(8, 1, &[0, 0, 1, 0])), "a window of a stream");
    }
    assert!(!RequestScan::new(Protocol::Http2).sees_request(b"GET / HTTP/1.1\r\n\r\n"));
    let mut lines = RequestScan::new(Protocol::Http1);
    assert!(!lines.sees_request(b"GET / HTTP/1.1\r\nHost: a\r\n"));
    assert!(lines.sees_request(b"\r\n"));
}
