//! Resources for which clients wait, instead of being refused.
//!
//! Invariant: a request that waits for the part of a client or a map holds nothing of the common share. A part has room
//! for the largest amount that is taken at once, so that every wait ends.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError, Weak},
};

use tidemap_store::MapId;
use tokio::sync::Semaphore;

use super::{client::Client, half};

/// The holder of a part.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Holder {
    Client(Client),
    Map(MapId),
}

/// A resource of which each client and each map has half at most. Clones share it.
#[derive(Clone, Debug)]
pub struct WaitedShare {
    all: Arc<Semaphore>,
    part: usize,
    // The parts have a lock, because streams come from all tasks; it is held only for a lookup.
    parts: Arc<Mutex<HashMap<Holder, Weak<Semaphore>>>>,
}

impl WaitedShare {
    /// Creates a share of `total`; nobody takes more than `largest` at once.
    pub fn new(total: usize, largest: usize) -> Self {
        Self { all: Arc::new(Semaphore::new(total)), part: half(total).max(largest), parts: Arc::default() }
    }

    /// The semaphores for which a client has to wait, one after the other, for work on a map.
    pub fn of(&self, client: &Client, map: MapId) -> Vec<Arc<Semaphore>> {
        let client = (!client.is_of_this_machine()).then(|| Holder::Client(client.clone()));
        let mut found: Vec<_> = client.into_iter().chain([Holder::Map(map)]).map(|holder| self.part(holder)).collect();
        found.push(Arc::clone(&self.all));
        found
    }

    fn part(&self, holder: Holder) -> Arc<Semaphore> {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(part) = parts.get(&holder).and_then(Weak::upgrade) {
            return part;
        }
        // Unused parts are removed.
        parts.retain(|_, part| part.strong_count() > 0);
        let part = Arc::new(Semaphore::new(self.part));
        parts.insert(holder, Arc::downgrade(&part));
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes everything that is free, one unit at a time.
    fn taken(shares: &[Arc<Semaphore>]) -> usize {
        let one = |share: &Arc<Semaphore>| share.try_acquire().ok().map(tokio::sync::SemaphorePermit::forget);
        std::iter::from_fn(|| shares.iter().map(one).collect::<Option<Vec<()>>>()).count()
    }

    #[test]
    fn a_client_and_a_map_leave_half_to_others() {
        let [one, other] = ["one", "other"].map(|id| Client::Token(id.into()));
        let share = WaitedShare::new(8, 1);
        let first = share.of(&one, MapId(1));
        assert_eq!(taken(&first), 4);
        assert_eq!(taken(&share.of(&one, MapId(2))), 0, "the client has its part");
        assert_eq!(taken(&share.of(&other, MapId(1))), 0, "the map has its part");
        assert_eq!(taken(&share.of(&other, MapId(2))), 4, "what is left");
    }

    #[test]
    fn a_part_has_room_for_the_largest_amount() {
        assert_eq!(taken(&WaitedShare::new(8, 6).of(&Client::Token("one".into()), MapId(1))), 6);
    }

    #[test]
    fn parts_that_nobody_uses_are_forgotten() {
        let share = WaitedShare::new(8, 1);
        for number in 0..100 {
            drop(share.of(&Client::Token(number.to_string().into()), MapId(number)));
        }
        assert!(share.parts.lock().expect("not poisoned").len() <= 2);
    }
}
