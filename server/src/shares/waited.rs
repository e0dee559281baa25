//! What clients wait for instead of being refused.
//!
//! Invariant: who waits for a client's or a map's part holds nothing of what all share. A part has room for the largest
//! amount that is taken at once, so that all that waits ends.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError, Weak},
};

use tidemap_store::MapId;
use tokio::sync::Semaphore;

use super::{client::Client, half};

/// Who has a part.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Holder {
    Client(Client),
    Map(MapId),
}

/// Something of which each client and each map has half at most. Clones share it.
#[derive(Clone, Debug)]
pub(crate) struct WaitedShare {
    all: Arc<Semaphore>,
    part: usize,
    // A lock, because streams come from all tasks; held only to look a part up.
    parts: Arc<Mutex<HashMap<Holder, Weak<Semaphore>>>>,
}

impl WaitedShare {
    /// `total` of it; nobody takes more than `largest` at once.
    pub(crate) fn new(total: usize, largest: usize) -> Self {
        Self { all: Arc::new(Semaphore::new(total)), part: half(total).max(largest), parts: Arc::default() }
    }

    /// What a client has to wait for, one after the other, for work on a map.
    pub(crate) fn of(&self, client: &Client, map: MapId) -> Vec<Arc<Semaphore>> {
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
        // Parts that nobody uses any more go.
        parts.retain(|_, part| part.strong_count() > 0);
        let part = Arc::new(Semaphore::new(self.part));
        parts.insert(holder, Arc::downgrade(&part));
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes all that there is, one at a time.
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
