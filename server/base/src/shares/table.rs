//! Tests the table "Shares" of the guide, row by row: one client fills the pool, and another one still works.
//!
//! Invariant: each row has a case here, and each share has a row.

use std::any::Any;

use super::{Share, ShareLimits, Shares, client::Client, waited::WaitedShare};
use crate::{
    config::Settings,
    connections::{ConnectionLimits, Connections, Peer, Port},
};
use tidemap_store::MapId;

const PAGE: &str = include_str!("../../../../docs/src/limits.md");

/// A part of a pool, held until it is dropped.
type HeldShare = Box<dyn Any>;

/// Takes one unit of a pool as a client; for bytes, a MiB.
type Take = Box<dyn Fn(u8) -> Option<HeldShare>>;

struct ShareRow {
    pool: String,
    in_all: usize,
    of_client: usize,
    setting: String,
}

fn number(cell: &str) -> usize {
    let digits: String = cell.chars().take_while(|c| c.is_ascii_digit() || *c == ',').filter(|c| *c != ',').collect();
    digits.parse().unwrap_or_else(|_| panic!("no number: {cell}"))
}

fn rows() -> Vec<ShareRow> {
    let section = PAGE.split("\n## ").find(|section| section.starts_with("Shares\n")).expect("the section");
    let lines = section.lines().filter(|line| line.starts_with("| ")).skip(2);
    let row = |line: &str| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [pool, in_all, of_client, setting] = cells[..] else { panic!("four cells: {line}") };
        ShareRow { pool: pool.into(), in_all: number(in_all), of_client: number(of_client), setting: setting.into() }
    };
    lines.map(row).collect()
}

fn peer(client: u8) -> Peer {
    Peer::Address([10, 0, 0, client].into())
}

fn connections(port: Port, (total, per_client): (usize, usize)) -> Take {
    let limits = ConnectionLimits { total, per_client, idle_after: std::time::Duration::from_secs(60) };
    let connections = Connections::new(port, limits);
    Box::new(move |client| {
        let slot = connections.admit(peer(client))?;
        let busy = slot.remote().busy(true);
        Some(Box::new((slot, busy)) as HeldShare)
    })
}

fn share(share: Share, amount: usize) -> Take {
    let shares = Shares::new(ShareLimits::of(&Settings::default()));
    Box::new(move |client| {
        // Each client has a map of its own: the share of a map is in another row.
        let whose = (&Client::Token(client.to_string().into()), MapId(client.into()));
        shares.take_for(share, whose, amount).ok().map(|taken| Box::new(taken) as HeldShare)
    })
}

fn buffers() -> Take {
    let settings = Settings::default();
    let share = WaitedShare::new(settings.max_buffer_bytes, settings.max_stream_buffer_bytes);
    Box::new(move |client| {
        let parts = share.of(&Client::Token(client.to_string().into()), MapId(client.into()));
        let one = |part: std::sync::Arc<tokio::sync::Semaphore>| part.try_acquire_many_owned(1 << 20).ok();
        parts.into_iter().map(one).collect::<Option<Vec<_>>>().map(|held| Box::new(held) as HeldShare)
    })
}

const MIB: usize = 1 << 20;
const HALVED_POOL: &str = "bytes of tables of tiles and unfinished scans";
const HTTP_POOL: &str = "connections of the HTTP port (by address)";

/// The rows of the shares, and the size of one unit.
const SHARES: [(&str, Share, usize); 11] = [
    ("requests under way", Share::Requests, 1),
    ("health checks without a token", Share::Open, 1),
    ("watches of health", Share::HealthWatches, 1),
    ("requests as JSON beyond 64 KiB", Share::LargeJson, 1),
    ("bytes of large requests that arrive", Share::LargeBytes, MIB),
    ("streams of observations", Share::Streams, 1),
    ("streams that have not sent hello", Share::Hellos, 1),
    (HALVED_POOL, Share::TableBytes, MIB),
    ("watches of anomalies", Share::Watches, 1),
    ("trained models that evaluations hold", Share::TrainedModels, 1),
    ("updates that were requested and have not ended", Share::Updates, 1),
];

/// A row that other tests fill: its pool, the test, and the file of the test.
type FilledElsewhere = (&'static str, &'static str, &'static str);

const IMPORT_TURNS: &str = include_str!("../../../web/src/recordings/turns.rs");

const FILLED_ELSEWHERE: [FilledElsewhere; 4] = [
    (
        "producers and labels of a map",
        "one_token_leaves_places_of_producers_to_others_also_after_a_restart",
        include_str!("../../../../tests/integration/forgotten_producers.rs"),
    ),
    (
        "states of a map",
        "one_token_leaves_states_of_a_map_to_others",
        include_str!("../../../../tests/integration/shares.rs"),
    ),
    (
        "tiles of a map",
        "one_token_leaves_tiles_of_a_map_to_others",
        include_str!("../../../../tests/integration/shares.rs"),
    ),
    ("imports of recordings", "one_map_one_token_and_one_address_leave_turns_to_others", IMPORT_TURNS),
];

/// The value of a constant of a file.
fn constant(file: &str, name: &str) -> usize {
    let (_, value) = file.split_once(&format!("const {name}: usize = ")).expect("the constant");
    number(value)
}

/// The bounds of a row that other tests fill.
fn bounds_elsewhere(pool: &str) -> (usize, usize) {
    let settings = Settings::default();
    match pool {
        "producers and labels of a map" => (settings.max_producers_per_map, settings.max_producers_per_client),
        "states of a map" => (settings.max_states_per_map, settings.max_states_per_map / 2),
        "tiles of a map" => (settings.max_tiles_per_map, settings.max_tiles_per_map / 2),
        // The value is read from the text of the source: the web uses the shares, and not the other way round.
        _ => (constant(IMPORT_TURNS, "TURNS"), constant(IMPORT_TURNS, "TURNS_OF_CLIENT")),
    }
}

/// Takes one unit of the pool of a row.
fn take(pool: &str) -> Option<Take> {
    let settings = Settings::default();
    if let Some((_, kind, amount)) = SHARES.iter().find(|(name, ..)| *name == pool) {
        return Some(share(*kind, *amount));
    }
    match pool {
        "connections (by address)" => {
            Some(connections(Port::Grpc, (settings.max_connections, settings.max_connections_per_client)))
        }
        HTTP_POOL => {
            let limits = crate::connections::HTTP_CONNECTIONS;
            Some(connections(Port::Http, (limits.total, limits.per_client)))
        }
        "bytes of streams that are not durable" => Some(buffers()),
        _ => None,
    }
}

#[test]
fn one_client_fills_its_part_of_each_pool_and_others_go_on() {
    let rows = rows();
    for ShareRow { pool, in_all, of_client, setting } in &rows {
        if let Some((_, test, file)) = FILLED_ELSEWHERE.iter().find(|(name, ..)| name == pool) {
            assert_eq!((*in_all, *of_client), bounds_elsewhere(pool), "{pool}");
            assert!(file.contains(&format!("fn {test}()")), "{pool}: {test}");
            continue;
        }
        let take = take(pool).unwrap_or_else(|| panic!("no case for the row {pool:?}"));
        let mut held: Vec<HeldShare> = Vec::new();
        let mut fill = |client: u8| {
            let before = held.len();
            held.extend(std::iter::from_fn(|| take(client)));
            held.len() - before
        };
        assert_eq!(fill(1), *of_client, "{pool}: what one client has");
        assert!(of_client < in_all, "{pool}");
        let others: usize = (2..=200).map(&mut fill).sum();
        // On the HTTP port, connections of the clients that have most make room for others.
        let may_be_more = pool == HTTP_POOL;
        // Each map takes half of the rest, so the last MiB is never taken.
        let may_be_less = pool == HALVED_POOL;
        let left = in_all - of_client;
        let is_right = others == left || (may_be_more && others > left) || (may_be_less && others + 1 == left);
        assert!(is_right, "{pool}: {others} are left to others, not {left}");
        drop(held);
        assert!(take(1).is_some(), "{pool}: all is free again");
        for name in setting.split('`').filter(|name| name.starts_with("max_")) {
            assert!(include_str!("../../../../deploy/tidemapd.toml").contains(&format!("#{name} = ")), "{name}");
        }
    }
    for (name, ..) in SHARES {
        assert!(rows.iter().any(|row| row.pool == name), "no row for {name:?}");
    }
}
