//! Tests the catalogue on a real store: callers that go away, and a failing store.

use std::{path::Path, time::Duration};

use tidemap_base::clock::SystemClock;
use tidemap_map::{
    event::{Event, NewState, StateKind, UpdateCause, UpdateStart},
    ids::StateId,
    name::StateName,
};
use tidemap_model::Zone;
use tidemap_store::{Store, StoreOptions};

use super::*;
use crate::jobs::Jobs;

fn store(dir: &Path) -> Store {
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    Store::open(dir, options).expect("a store")
}

fn context(store: Store) -> Context {
    Context {
        store: Arc::new(store),
        jobs: Arc::new(Jobs::default()),
        clock: Arc::new(SystemClock),
        update_turns: Arc::new(crate::update_turns::UpdateTurns::new(1)),
        fatal: tokio::sync::mpsc::unbounded_channel().0,
        forks: tokio::sync::mpsc::unbounded_channel().0,
        max_states: 10,
        max_producers: 10,
        max_producers_of_client: 10,
        max_pending: tidemap_map::live_map::PendingLimits { observations: 1000, changes: 1000 },
        update_readings_max: tidemap_map::update::UPDATE_READINGS_MAX,
        update_at_midnight: true,
        max_tiles: 20,
        tile_cache_bytes: 1 << 30,
        cluster: None,
    }
}

fn catalog(store: Store) -> Result<Catalog, CatalogError> {
    Ok(Catalog::open(context(store), 10, u64::MAX)?.0)
}

fn opened_first(store: Store, restored_first_bytes: u64) -> (Catalog, Vec<UnopenedMap>) {
    Catalog::open(context(store), 10, restored_first_bytes).expect("maps")
}

fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/London").expect("known"),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

/// Starts the work and drops it.
async fn abandon<T>(work: impl Future<Output = T>) {
    tokio::select! {
        biased;
        _ = work => panic!("ended at once"),
        () = std::future::ready(()) => {}
    }
}

async fn wait_until(is_so: impl Fn() -> bool) {
    let waiting = async {
        while !is_so() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(30), waiting).await.expect("it comes to its end");
}

#[tokio::test]
async fn what_was_begun_is_ended_without_its_caller() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let catalog = catalog(store(dir.path())).expect("no maps");
    abandon(catalog.create(spec())).await;
    wait_until(|| catalog.get("office").is_ok()).await;
    assert!(matches!(catalog.create(spec()).await, Err(CatalogError::Exists(_))));
    abandon(catalog.delete("office")).await;
    wait_until(|| catalog.context().store.maps().is_empty()).await;
    catalog.create(spec()).await.expect("the name is free");
}

#[tokio::test]
async fn a_deletion_that_fails_can_be_tried_again() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let catalog = catalog(store(dir.path())).expect("no maps");
    catalog.create(spec()).await.expect("created");
    let (maps, away) = (dir.path().join("maps"), dir.path().join("away"));
    std::fs::rename(&maps, &away).expect("moved away");
    assert!(matches!(catalog.delete("office").await, Err(CatalogError::Store(_))));
    assert!(catalog.get("office").is_ok());
    assert!(matches!(catalog.create(spec()).await, Err(CatalogError::Exists(_))));
    std::fs::rename(&away, &maps).expect("moved back");
    catalog.delete("office").await.expect("deleted");
    assert!(catalog.context().store.maps().is_empty());
    catalog.create(spec()).await.expect("the name is free");
}

#[test]
fn of_two_maps_of_one_name_the_second_is_set_aside() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let store = store(dir.path());
    let (first, second) = (store.create_map(&spec()).expect("one"), store.create_map(&spec()).expect("two"));
    let catalog = catalog(store).expect("one of them");
    assert_eq!(catalog.get("office").expect("the first").id, first);
    let unavailable = catalog.unavailable();
    let [map] = &unavailable[..] else { panic!("{unavailable:?}") };
    assert_eq!((map.id, map.name.as_str()), (second, "office"));
    assert!(map.reason.contains(&format!("maps {} and {} ", first.0, second.0)), "{map:?}");
}

#[tokio::test]
async fn a_large_map_shows_what_the_index_publishes_until_it_is_restored() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (before, id) = {
        let store = store(dir.path());
        let id = store.create_map(&spec()).expect("created");
        let mut map = LiveMap::new(Arc::new(spec()));
        let log = store.open_map(id, &spec()).expect("opened").log;
        let door = StateName::new("door").expect("valid");
        let new = NewState::sampled(StateId(0), door, StateKind::Probability);
        let cut_nanos = 1_700_000_000_000_000_000;
        let start = UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::Request };
        let events = [Event::AddState(new), Event::UpdateStart(start)];
        let mut saved = None;
        for (position, event) in (1..).zip(&events) {
            let (sender, receiver) = std::sync::mpsc::channel();
            log.append(event, Box::new(move |result| sender.send(result).expect("waiting"))).expect("queued");
            assert_eq!(receiver.recv().expect("answered"), Ok(position));
            if let Some(work) = map.apply(position, event).expect("consistent") {
                let done = std::sync::atomic::AtomicU64::new(0);
                saved = Some(map.finish_update(work.run(&done).expect("no tiles")));
            }
        }
        store.save(id, &saved.expect("an update")).expect("saved");
        // The log has one more state than the index.
        let hatch = StateName::new("hatch").expect("valid");
        let new = NewState::sampled(StateId(1), hatch, StateKind::Probability);
        let (sender, receiver) = std::sync::mpsc::channel();
        let done: tidemap_store::Done = Box::new(move |result| sender.send(result).expect("waiting"));
        log.append(&Event::AddState(new), done).expect("queued");
        assert_eq!(receiver.recv().expect("answered"), Ok(3));
        (map.publish(), id)
    };
    let (catalog, rest) = opened_first(store(dir.path()), 0);
    let handle = catalog.get("office").expect("listed");
    assert_eq!((handle.id, rest.len()), (id, 1));
    assert_eq!(handle.opening(), OpenProgress::Replay { done: 0, total: 0 });
    let view = handle.view();
    assert_eq!((view.generation(), view.len(), view.position()), (1, 1, before.position()));
    assert!(view.find("hatch").is_none(), "the log is not replayed");
    let waiting = {
        let handle = Arc::clone(&handle);
        tokio::spawn(async move { handle.opened().await })
    };
    let restoring = catalog.clone();
    tokio::task::spawn_blocking(move || restoring.restore_rest(rest)).await.expect("ran").expect("restored");
    assert!(waiting.await.expect("ran"), "it is open");
    assert_eq!(handle.opening(), OpenProgress::Open);
    assert!(handle.view().find("hatch").is_some(), "the log is replayed");
    catalog.stop().await;
}

#[tokio::test]
async fn a_stop_does_not_wait_for_a_map_that_is_never_restored() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let catalog = catalog(store(dir.path())).expect("no maps");
    let map = LiveMap::new(Arc::new(spec())).publish();
    let (handle, endpoints) =
        MapHandle::with_endpoints((MapId(1), None), Arc::new(spec()), map, &catalog.context().clock);
    drop(endpoints);
    assert!(!handle.opened().await);
    catalog.stop().await;
}

#[tokio::test]
async fn a_damaged_map_is_set_aside_and_the_others_serve() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let named = |name: &str| MapSpec { name: MapName::new(name).expect("valid"), ..spec() };
    {
        let store = store(dir.path());
        for name in ["office", "lab", "store"] {
            store.create_map(&named(name)).expect("creates");
        }
        store.close();
    }
    let log = dir.path().join("maps/00000001/log/00000000000000000001.log");
    let mut bytes = std::fs::read(&log).expect("readable");
    bytes[12] ^= 1;
    std::fs::write(&log, &bytes).expect("writable");
    std::fs::remove_dir_all(dir.path().join("maps/00000003")).expect("removable");

    let catalog = catalog(store(dir.path())).expect("the other map");
    assert_eq!(catalog.all().keys().map(MapName::as_str).collect::<Vec<_>>(), ["lab"]);
    for (name, word) in [("office", "header of the segment"), ("store", "folder is missing")] {
        let error = catalog.get(name).expect_err("unavailable");
        assert!(matches!(&error, CatalogError::Unavailable { reason, .. } if reason.contains(word)), "{error}");
        assert!(!error.to_string().contains(dir.path().to_str().expect("text")), "{error}");
        assert!(matches!(catalog.create(named(name)).await, Err(CatalogError::Unavailable { .. })));
    }
    assert_eq!(std::fs::read(&log).expect("readable"), bytes, "its files are left as they are");
    catalog.delete("office").await.expect("deletes");
    assert!(matches!(catalog.get("office"), Err(CatalogError::Unknown(_))));
    catalog.create(named("office")).await.expect("creates");
    catalog.stop().await;
}
