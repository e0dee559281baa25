//! The catalogue on a real store: callers that go away, and a failing store.

use std::{path::Path, time::Duration};

use tidemap_model::Zone;
use tidemap_store::{Store, StoreOptions};

use super::*;
use crate::{clock::SystemClock, jobs::Jobs};

fn store(dir: &Path) -> Store {
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    Store::open(dir, options).expect("a store")
}

fn catalog(store: Store) -> Result<Catalog, CatalogError> {
    let context = Context {
        store: Arc::new(store),
        jobs: Arc::new(Jobs::default()),
        clock: Arc::new(SystemClock),
        update_pool: Arc::new(rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool")),
        fatal: tokio::sync::mpsc::unbounded_channel().0,
        max_states: 10,
        max_producers: 10,
        max_pending: tidemap_map::live_map::PendingLimits { observations: 1000, changes: 1000 },
        max_tiles: 20,
        tile_cache_bytes: 1 << 30,
    };
    Catalog::open(context, 10)
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
fn two_maps_of_one_name_are_not_served() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let store = store(dir.path());
    let (first, second) = (store.create_map(&spec()).expect("one"), store.create_map(&spec()).expect("two"));
    let error = catalog(store).expect_err("not both");
    assert!(error.to_string().contains(&format!("maps {} and {} ", first.0, second.0)), "{error}");
}
