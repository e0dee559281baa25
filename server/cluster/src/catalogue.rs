//! The maps of a cluster, in the bucket of maps: a key for each name, and a key for each map that was deleted.
//!
//! Invariant: a name belongs to one map at a time. A map is deleted only where its number is among the deleted ones: a
//! key that is missing, because the engine has forgotten it, deletes nothing.

use std::collections::BTreeSet;

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use crate::engine::{Bucket, Engine, EngineError, SetError};

const NAME_PREFIX: &str = "name.";
const DELETED_PREFIX: &str = "deleted.";
const ID_KEY: &str = "cluster";
const SECRET_KEY: &str = "secret";

/// A map of the cluster.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClusterMap {
    /// Number of the map, as 16 hexadecimal digits.
    uid: String,
    /// Fixed properties of the map, as the store encodes them, in hexadecimal digits.
    spec: String,
    /// The daemon that an operator has chosen as the writer of the map, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pinned: Option<String>,
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

impl ClusterMap {
    /// A map with its number and its fixed properties, encoded.
    #[must_use]
    pub fn new(uid: u64, spec: &[u8]) -> ClusterMap {
        ClusterMap { uid: format!("{uid:016x}"), spec: hex(spec), pinned: None }
    }

    /// Number of the map in the cluster; `None` where the key is damaged.
    #[must_use]
    pub fn uid(&self) -> Option<u64> {
        u64::from_str_radix(&self.uid, 16).ok()
    }

    /// Fixed properties of the map, encoded; `None` where the key is damaged.
    #[must_use]
    pub fn spec(&self) -> Option<Vec<u8>> {
        let digits = self.spec.as_bytes();
        let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
        if digits.len().is_multiple_of(2) { digits.chunks(2).map(byte).collect() } else { None }
    }

    fn encode(&self) -> Bytes {
        serde_json::to_vec(self).unwrap_or_default().into()
    }
}

/// Name of the stream of a map.
#[must_use]
pub fn stream(uid: u64) -> String {
    format!("tm_{uid:016x}")
}

/// The content of the catalogue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Listing {
    /// Maps by name, in their order, each with the revision of its key.
    pub maps: Vec<(String, ClusterMap, u64)>,
    /// Numbers of maps that were deleted.
    pub deleted: BTreeSet<u64>,
}

/// The identity of the cluster. The first daemon that calls this creates it.
///
/// # Errors
/// [`EngineError`].
pub async fn cluster_id<E: Engine>(engine: &E, proposed: &str) -> Result<String, EngineError> {
    made_once(engine, ID_KEY, proposed).await
}

/// The secret by which the daemons of the cluster authenticate each other. The first daemon that calls this creates it.
/// A program that can read this secret can also read the logs of the maps.
///
/// # Errors
/// [`EngineError`].
pub async fn cluster_secret<E: Engine>(engine: &E, proposed: &str) -> Result<String, EngineError> {
    made_once(engine, SECRET_KEY, proposed).await
}

/// The value of a key that is set once: the stored value, or else the proposed one, which is then stored.
async fn made_once<E: Engine>(engine: &E, key: &str, proposed: &str) -> Result<String, EngineError> {
    match engine.set_if(Bucket::Maps, key, 0, Bytes::from(proposed.to_owned())).await {
        Ok(_) => Ok(proposed.to_owned()),
        Err(_) => {
            let entry = engine.get(Bucket::Maps, key).await?;
            let missing = || EngineError::Unavailable(format!("the cluster has no {key} yet"));
            Ok(String::from_utf8_lossy(&entry.ok_or_else(missing)?.value).into_owned())
        }
    }
}

/// The maps of the cluster.
///
/// # Errors
/// [`EngineError`].
pub async fn list<E: Engine>(engine: &E) -> Result<Listing, EngineError> {
    let mut listing = Listing::default();
    for (key, entry) in engine.list(Bucket::Maps).await? {
        if let Some(name) = key.strip_prefix(NAME_PREFIX) {
            let Ok(map) = serde_json::from_slice::<ClusterMap>(&entry.value) else { continue };
            listing.maps.push((name.to_owned(), map, entry.revision));
        } else if let Some(uid) = key.strip_prefix(DELETED_PREFIX) {
            listing.deleted.extend(u64::from_str_radix(uid, 16));
        }
    }
    listing.maps.sort_by(|(a, ..), (b, ..)| a.cmp(b));
    Ok(listing)
}

/// The map of a name, with the revision of its key.
///
/// # Errors
/// [`EngineError`].
pub async fn find<E: Engine>(engine: &E, name: &str) -> Result<Option<(ClusterMap, u64)>, EngineError> {
    let entry = engine.get(Bucket::Maps, &format!("{NAME_PREFIX}{name}")).await?;
    Ok(entry.and_then(|entry| Some((serde_json::from_slice(&entry.value).ok()?, entry.revision))))
}

/// Whether a map was deleted.
///
/// # Errors
/// [`EngineError`].
pub async fn is_deleted<E: Engine>(engine: &E, uid: u64) -> Result<bool, EngineError> {
    Ok(engine.get(Bucket::Maps, &format!("{DELETED_PREFIX}{uid:016x}")).await?.is_some())
}

/// Adds a map, whose stream exists, under a name that no map has.
///
/// # Errors
/// [`SetError::NotExpected`]: there is a map of the name.
pub async fn add<E: Engine>(engine: &E, name: &str, map: &ClusterMap) -> Result<u64, SetError> {
    engine.set_if(Bucket::Maps, &format!("{NAME_PREFIX}{name}"), 0, map.encode()).await
}

/// Changes the entry of a map that has this revision.
///
/// # Errors
/// [`SetError::NotExpected`]: the entry has another revision, because somebody has changed it meanwhile.
pub async fn change<E: Engine>(engine: &E, name: &str, revision: u64, map: &ClusterMap) -> Result<u64, SetError> {
    engine.set_if(Bucket::Maps, &format!("{NAME_PREFIX}{name}"), revision, map.encode()).await
}

/// Deletes a map for good: its number, its name, and its stream. Can be repeated where it was interrupted.
///
/// # Errors
/// [`EngineError`].
pub async fn delete<E: Engine>(engine: &E, name: &str, uid: u64) -> Result<(), EngineError> {
    engine.set(Bucket::Maps, &format!("{DELETED_PREFIX}{uid:016x}"), Bytes::from_static(b"{}")).await?;
    if let Some((map, revision)) = find(engine, name).await?
        && map.uid() == Some(uid)
    {
        match engine.delete_if(Bucket::Maps, &format!("{NAME_PREFIX}{name}"), revision).await {
            Ok(()) | Err(SetError::NotExpected) => {}
            Err(SetError::Engine(error)) => return Err(error),
        }
    }
    engine.delete_stream(&stream(uid)).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{EngineFaults, Simulation};

    #[tokio::test(start_paused = true)]
    async fn a_name_belongs_to_one_map_until_it_is_deleted() {
        let engine = Simulation::new(1, EngineFaults::none()).client("a");
        engine.create_buckets(3).await.expect("made");
        let id = cluster_id(&engine, "one").await.expect("made");
        assert_eq!((id.as_str(), cluster_id(&engine, "two").await.expect("there").as_str()), ("one", "one"));
        let secret = cluster_secret(&engine, "first").await.expect("made");
        assert_eq!(
            (secret.as_str(), cluster_secret(&engine, "second").await.expect("there").as_str()),
            ("first", "first")
        );
        let map = ClusterMap::new(0xAB, &[1, 2, 255]);
        add(&engine, "office", &map).await.expect("new");
        assert_eq!(add(&engine, "office", &ClusterMap::new(2, &[])).await, Err(SetError::NotExpected));
        let (found, revision) = find(&engine, "office").await.expect("read").expect("there");
        assert_eq!((found.uid(), found.spec()), (Some(0xAB), Some(vec![1, 2, 255])));
        let pinned = ClusterMap { pinned: Some("b".to_owned()), ..map };
        change(&engine, "office", revision, &pinned).await.expect("as it was");
        assert_eq!(change(&engine, "office", revision, &pinned).await, Err(SetError::NotExpected));
        engine.create_stream(&stream(0xAB), 3).await.expect("made");
        for _ in 0..2 {
            delete(&engine, "office", 0xAB).await.expect("deleted");
        }
        let listing = list(&engine).await.expect("read");
        assert_eq!((listing.maps, listing.deleted), (Vec::new(), BTreeSet::from([0xAB])));
        add(&engine, "office", &ClusterMap::new(2, &[])).await.expect("the name is free");
        // A deletion that comes late deletes the old map only.
        delete(&engine, "office", 0xAB).await.expect("deleted");
        assert_eq!(list(&engine).await.expect("read").maps.len(), 1);
    }
}
