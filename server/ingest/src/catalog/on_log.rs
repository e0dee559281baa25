//! A map on a log of a test's own, which daemons share; only in builds for tests.
//!
//! Invariant: the map begins as a follower.

use std::sync::Arc;

use tidemap_map::spec::MapSpec;
use tidemap_store::EventLog;

use super::{ByName, Catalog, restore_map};
use crate::{
    handle::MapHandle,
    writer::{RestoredMap, start_in},
};

impl Catalog {
    /// Creates a map that begins as a follower, and whose events go to this log.
    ///
    /// # Panics
    /// The store cannot create it.
    pub fn create_on(&self, spec: MapSpec, log: Arc<dyn EventLog>) -> Arc<MapHandle> {
        let (context, spec) = (self.context.clone(), Arc::new(spec));
        let id = context.store.create_map(&spec).expect("created");
        let mut restored = restore_map(&context, id, &spec, &|_, _| true).expect("restored");
        let view = restored.map.publish();
        let (handle, endpoints) = MapHandle::with_endpoints((id, None), Arc::clone(&spec), view, &context.clock);
        start_in(endpoints, context, id, RestoredMap { log, is_shared: true, ..restored }).expect("a thread");
        let handle = Arc::new(handle);
        let mut maps = ByName::clone(&self.maps.load());
        maps.insert(spec.name.clone(), Arc::clone(&handle));
        self.maps.store(Arc::new(maps));
        handle
    }
}
