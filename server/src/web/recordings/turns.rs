//! Who may import a recording now.
//!
//! Invariant: at most [`TURNS`] imports at a time, one of a map, one of a token and [`TURNS_OF_CLIENT`] of an address,
//! so that the robots of one map do not take the turns of another. What the programs of all may take of the memory is
//! counted together. A turn is free when it is dropped.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tidemap_map::name::MapName;

use super::memory::{self, NoMemory};
use crate::connections::Peer;

/// Imports at a time.
const TURNS: usize = 4;
/// Imports of one address at a time.
const TURNS_OF_CLIENT: usize = 2;
/// What to do where there is no turn.
const LATER: &str = "try again when it has ended";

/// The turns. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns(Arc<Mutex<[Option<Holder>; TURNS]>>);

/// Who has a turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Holder {
    pub(super) map: MapName,
    pub(super) peer: Peer,
    /// The public part of the sender's token.
    pub(super) token: Option<String>,
    /// What the program may take of the memory, in bytes.
    pub(super) memory: u64,
}

/// A turn to import.
#[derive(Debug)]
pub(super) struct Turn {
    number: usize,
    memory: u64,
    turns: Turns,
}

/// Why there is no turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoTurn {
    #[error("another recording is being imported into this map, and only one can be at a time: {LATER}")]
    OfMap,
    #[error("another recording is being imported by this token, and only one can be at a time: {LATER}")]
    OfToken,
    #[error("{TURNS_OF_CLIENT} recordings are being imported from this address, and no more can be at a time: {LATER}")]
    OfClient,
    #[error("{TURNS} recordings are being imported, and no more can be at a time: {LATER}")]
    All,
    #[error(transparent)]
    Memory(#[from] NoMemory),
}

impl Turns {
    fn lock(&self) -> MutexGuard<'_, [Option<Holder>; TURNS]> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a turn for who wants to import into a map.
    ///
    /// # Errors
    /// There is none, or the machine has no memory for the program.
    pub(super) fn take(&self, map: &MapName, peer: Peer, token: Option<&str>) -> Result<Turn, NoTurn> {
        let mut holders = self.lock();
        let count = |is_so: &dyn Fn(&Holder) -> bool| holders.iter().flatten().filter(|holder| is_so(holder)).count();
        if count(&|holder| holder.map == *map) > 0 {
            return Err(NoTurn::OfMap);
        }
        if token.is_some() && count(&|holder| holder.token.as_deref() == token) > 0 {
            return Err(NoTurn::OfToken);
        }
        if count(&|holder| holder.peer == peer) >= TURNS_OF_CLIENT {
            return Err(NoTurn::OfClient);
        }
        let number = holders.iter().position(Option::is_none).ok_or(NoTurn::All)?;
        let promised = holders.iter().flatten().map(|holder| holder.memory).sum();
        let memory = memory::for_program(promised)?;
        let holder = Holder { map: map.clone(), peer, token: token.map(str::to_owned), memory };
        holders[number] = Some(holder);
        drop(holders);
        Ok(Turn { number, memory, turns: self.clone() })
    }

    /// Whether one is taken.
    #[cfg(test)]
    pub(super) fn any(&self) -> bool {
        self.lock().iter().any(Option::is_some)
    }

    /// Does something while no turn begins or ends.
    pub(super) fn still<T>(&self, work: impl FnOnce() -> T) -> T {
        let _still = self.lock();
        work()
    }
}

impl Turn {
    /// The number of the turn: no other has it meanwhile.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// What the program may take of the memory, in bytes.
    pub(super) fn memory(&self) -> u64 {
        self.memory
    }

    /// All turns.
    pub(super) fn turns(&self) -> &Turns {
        &self.turns
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.turns.lock()[self.number] = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(turns: &Turns, map: &str, last: u8, token: Option<&str>) -> Result<Turn, NoTurn> {
        let map = MapName::new(map).expect("a name");
        turns.take(&map, Peer::Address([10, 0, 0, last].into()), token)
    }

    #[test]
    fn one_map_one_token_and_one_address_leave_turns_to_others() {
        let turns = Turns::default();
        let first = take(&turns, "a", 1, Some("robot")).expect("a turn");
        assert_eq!(take(&turns, "a", 2, Some("other")).err(), Some(NoTurn::OfMap));
        assert_eq!(take(&turns, "b", 2, Some("robot")).err(), Some(NoTurn::OfToken));
        let second = take(&turns, "b", 1, None).expect("without a token the address counts");
        assert_eq!(take(&turns, "c", 1, None).err(), Some(NoTurn::OfClient));
        let others = [take(&turns, "c", 2, None), take(&turns, "d", 2, None)];
        assert!(others.iter().all(Result::is_ok));
        assert_eq!(take(&turns, "e", 3, None).err(), Some(NoTurn::All));
        drop(first);
        let next = take(&turns, "a", 3, Some("robot")).expect("free again");
        assert_eq!((next.number(), second.number()), (0, 1));
    }
}
