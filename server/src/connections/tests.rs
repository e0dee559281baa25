//! Who makes room, when the bounds of connections are reached.

use super::{
    request_scan::{Protocol, RequestScan},
    *,
};

fn address(last: u8) -> Peer {
    Peer::Address(IpAddr::from([10, 0, 0, last]))
}

fn is_displaced(place: &Place) -> bool {
    place.seat.is_displaced.load(Ordering::Acquire)
}

#[test]
fn the_oldest_connection_that_never_asked_makes_room() {
    let connections = Connections::new(ConnectionLimits { total: 3, per_client: 3 });
    let busy = connections.admit(address(1)).expect("room");
    busy.seat.asks();
    let silent: Vec<Place> = (0..2).map(|_| connections.admit(address(2)).expect("room")).collect();
    let newcomer = connections.admit(address(3)).expect("the oldest silent one makes room");
    assert_eq!([&busy, &silent[0], &silent[1], &newcomer].map(is_displaced), [false, true, false, false]);
    let next = connections.admit(address(3)).expect("the other silent one makes room");
    assert!(is_displaced(&silent[1]));
    newcomer.seat.asks();
    next.seat.asks();
    assert!(connections.admit(address(4)).is_none(), "all others are busy");
    drop(busy);
    drop(silent);
    assert!(connections.admit(address(4)).is_some());
}

#[test]
fn a_client_at_its_bound_displaces_only_its_own_connections() {
    let connections = Connections::new(ConnectionLimits { total: 10, per_client: 2 });
    let other = connections.admit(address(1)).expect("room");
    let own: Vec<Place> = (0..2).map(|_| connections.admit(address(2)).expect("room")).collect();
    let third = connections.admit(address(2)).expect("its oldest makes room");
    assert_eq!([&other, &own[0], &own[1], &third].map(is_displaced), [false, true, false, false]);
    own[1].seat.asks();
    third.seat.asks();
    assert!(connections.admit(address(2)).is_none(), "its others are busy");
    assert!(connections.admit(address(3)).is_some());
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
        assert!(scan.sees_request(&frame(8, 1, &[0, 0, 1, 0])), "a window of a stream");
    }
    assert!(!RequestScan::new(Protocol::Http2).sees_request(b"GET / HTTP/1.1\r\n\r\n"));
    let mut lines = RequestScan::new(Protocol::Http1);
    assert!(!lines.sees_request(b"GET / HTTP/1.1\r\nHost: a\r\n"));
    assert!(lines.sees_request(b"\r\n"));
}
