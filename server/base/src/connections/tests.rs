//! Tests of which connection makes room when the bounds are reached, and how long a connection may make no request.

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

use super::{guard::GuardedConnection, *};

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
fn a_client_with_few_connections_gets_one_of_who_has_the_most() {
    let full = |port| {
        let connections = connections(port, 12, 10);
        let all: Vec<ConnectionSlot> =
            (0..12).map(|number| connections.admit(address(u8::from(number >= 10))).expect("room")).collect();
        let requests: Vec<Busy> = all.iter().map(|slot| request(slot, true)).collect();
        (connections, all, requests)
    };
    let (connections, all, _requests) = full(Port::Http);
    let newcomer = connections.admit(address(2)).expect("one makes room");
    let _works = request(&newcomer, true);
    let displaced: Vec<usize> = (0..all.len()).filter(|slot| is_displaced(&all[*slot])).collect();
    assert_eq!(displaced, [9], "the newest of the client that has the most");
    let second = connections.admit(address(2)).expect("another makes room");
    let _works_too = request(&second, true);
    assert!(is_displaced(&all[8]) && !is_displaced(&newcomer));
    assert!(connections.admit(address(0)).is_none(), "who has the most gets none");
    let (connections, _all, _requests) = full(Port::Grpc);
    assert!(connections.admit(address(2)).is_none(), "robots keep their connections");
}

#[test]
fn a_connection_whose_reply_nobody_reads_makes_room() {
    let connections = connections(Port::Http, 2, 2);
    let slots: Vec<ConnectionSlot> = (0..2).map(|last| connections.admit(address(last)).expect("room")).collect();
    let _requests: Vec<Busy> = slots.iter().map(|slot| request(slot, true)).collect();
    assert!(connections.admit(address(2)).is_none(), "both work on a request");
    let now = Instant::now();
    let rank = |slot: &ConnectionSlot, later: Duration| slot.seat.rank(Duration::ZERO, now + later);
    slots[1].seat.note_stall(Some(tokio::time::Instant::now()));
    assert_eq!(rank(&slots[1], STALLED_AFTER / 2), None, "it is waited for a little");
    assert!(rank(&slots[1], 2 * STALLED_AFTER).is_some() && rank(&slots[0], 2 * STALLED_AFTER).is_none());
    slots[1].seat.note_stall(None);
    assert_eq!(rank(&slots[1], 2 * STALLED_AFTER), None, "it reads again");
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

/// A connection with some bytes to read, and the time after which reading it first fails; `None`: never.
async fn reading_fails_after(port: Port, makes_request: bool) -> Option<Duration> {
    let slot = connections(port, 2, 2).admit(address(1)).expect("room");
    let (socket, mut client) = tokio::io::duplex(64);
    let mut guarded = GuardedConnection::new(socket, slot);
    // Bytes are no request: the layers of the services report requests.
    client.write_all(b"PRI * HTTP/2.0").await.expect("room");
    guarded.read_exact(&mut [0; 14]).await.expect("what was sent");
    if makes_request {
        guarded.remote().note_request();
    }
    let start = tokio::time::Instant::now();
    let read = tokio::time::timeout(4 * REQUEST_WITHIN, guarded.read_u8()).await;
    read.is_ok_and(|read| read.is_err()).then(|| start.elapsed())
}

#[tokio::test(start_paused = true)]
async fn a_connection_without_a_request_ends_and_one_with_a_request_stays() {
    for port in [Port::Grpc, Port::Http] {
        let silent = reading_fails_after(port, false).await.expect("it made no request");
        assert!(silent >= REQUEST_WITHIN && silent < 2 * REQUEST_WITHIN, "{silent:?}");
        assert_eq!(reading_fails_after(port, true).await, None, "{port:?}");
    }
    assert!(reading_fails_after(Port::Probes, true).await.is_some(), "the reserve serves no connection for long");
}
