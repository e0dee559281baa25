//! The places of a map that are taken for ever, which are those of states and of tiles, and the part of them that one
//! client takes.
//!
//! Invariant: since the daemon opened the map, one client adds at most half of the places that were free then. So there
//! is always room for another client. Places of events that could not be written count for nobody. Programs of the
//! daemon's own machine without a token have no share of their own: their name is empty.

use std::collections::HashMap;

use super::super::protocol::NoRoom;

/// The kind of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PlaceKind {
    States,
    Tiles,
}

/// The places of one kind.
#[derive(Debug)]
pub(super) struct Places {
    kind: PlaceKind,
    max: usize,
    /// Number of places that one client may add; known after the first addition.
    share: Option<usize>,
    /// Number of places that each client has taken with applied events.
    added: HashMap<String, usize>,
    /// Number of places that each client has taken with events that are not written yet.
    in_flight: HashMap<String, usize>,
}

/// The number of places that a client may take now, and the reason why it may take no more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Room {
    free: usize,
    taken: usize,
    full: NoRoom,
}

impl Room {
    /// Number of places that are left.
    pub(super) fn left(&self) -> usize {
        self.free - self.taken
    }

    /// The reason why there are no more places.
    pub(super) fn full(&self) -> NoRoom {
        self.full.clone()
    }

    /// Number of places that were taken of this room.
    pub(super) fn taken(&self) -> usize {
        self.taken
    }

    /// Takes places.
    ///
    /// # Errors
    /// There are too few; then none is taken.
    pub(super) fn take(&mut self, count: usize) -> Result<(), NoRoom> {
        if count > self.left() {
            return Err(self.full());
        }
        self.taken += count;
        Ok(())
    }
}

impl Places {
    pub(super) fn new(kind: PlaceKind, max: usize) -> Self {
        Self { kind, max, share: None, added: HashMap::new(), in_flight: HashMap::new() }
    }

    /// The room of a client in a map with `used` places in use.
    pub(super) fn room(&mut self, client: &str, used: usize) -> Room {
        let free = self.max.saturating_sub(used);
        let share = *self.share.get_or_insert(free.div_ceil(2));
        let known = [&self.added, &self.in_flight].map(|counts| counts.get(client).copied().unwrap_or(0));
        let of_client = share.saturating_sub(known.iter().sum());
        if client.is_empty() || free <= of_client {
            return Room { free, taken: 0, full: self.full() };
        }
        let (client, max) = (client.to_owned(), share);
        let full = match self.kind {
            PlaceKind::States => NoRoom::StatesOfClient { client, max },
            PlaceKind::Tiles => NoRoom::TilesOfClient { client, max },
        };
        Room { free: of_client, taken: 0, full }
    }

    fn full(&self) -> NoRoom {
        match self.kind {
            PlaceKind::States => NoRoom::States { max: self.max },
            PlaceKind::Tiles => NoRoom::Tiles { max: self.max },
        }
    }

    /// A client takes places, with an event that is handed to the log.
    pub(super) fn take(&mut self, client: &str, count: usize) {
        if count > 0 && !client.is_empty() {
            *self.in_flight.entry(client.to_owned()).or_default() += count;
        }
    }

    /// The event of a client was written and applied.
    pub(super) fn applied(&mut self, client: &str, count: usize) {
        let Some(in_flight) = self.in_flight.get_mut(client).filter(|_| count > 0) else { return };
        *in_flight = in_flight.saturating_sub(count);
        if *in_flight == 0 {
            self.in_flight.remove(client);
        }
        *self.added.entry(client.to_owned()).or_default() += count;
    }

    /// No event in flight was written.
    pub(super) fn roll_back(&mut self) {
        self.in_flight.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes all places that a client gets in a map with `used` places in use; returns their number, and the reason why
    /// there are no more.
    fn fill(places: &mut Places, client: &str, used: &mut usize) -> (usize, NoRoom) {
        for count in 0.. {
            let mut room = places.room(client, *used);
            if let Err(full) = room.take(1) {
                return (count, full);
            }
            places.take(client, room.taken());
            places.applied(client, room.taken());
            *used += 1;
        }
        unreachable!("the map is full at last")
    }

    #[test]
    fn a_client_leaves_half_of_what_was_free_to_others() {
        let (mut places, mut used) = (Places::new(PlaceKind::States, 13), 3);
        let (count, full) = fill(&mut places, "token one", &mut used);
        assert_eq!((count, full), (5, NoRoom::StatesOfClient { client: "token one".to_owned(), max: 5 }));
        assert_eq!(fill(&mut places, "token two", &mut used), (5, NoRoom::States { max: 13 }));
    }

    #[test]
    fn the_last_place_is_free_for_anybody() {
        let (mut places, mut used) = (Places::new(PlaceKind::Tiles, 1), 0);
        assert_eq!(fill(&mut places, "token one", &mut used), (1, NoRoom::Tiles { max: 1 }));
    }

    #[test]
    fn programs_of_this_machine_fill_a_map() {
        let (mut places, mut used) = (Places::new(PlaceKind::Tiles, 10), 0);
        assert_eq!(fill(&mut places, "", &mut used), (10, NoRoom::Tiles { max: 10 }));
    }

    #[test]
    fn what_could_not_be_written_gives_its_places_back() {
        let mut places = Places::new(PlaceKind::States, 8);
        for _ in 0..3 {
            assert_eq!(places.room("token one", 0).left(), 4);
            places.take("token one", 4);
            assert_eq!(places.room("token one", 4).left(), 0, "events in flight count");
            places.roll_back();
        }
        places.take("token one", 3);
        places.applied("token one", 3);
        places.roll_back();
        assert_eq!(places.room("token one", 3).left(), 1);
    }

    #[test]
    fn what_does_not_fit_whole_takes_nothing() {
        let mut places = Places::new(PlaceKind::States, 10);
        let mut room = places.room("token one", 0);
        assert!(room.take(6).is_err());
        assert_eq!(room.left(), 5);
        assert!(room.take(5).is_ok());
    }
}
