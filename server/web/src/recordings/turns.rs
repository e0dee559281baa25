//! Turns to import a recording.
//!
//! Invariant: at most [`TURNS`] imports run at a time, one per map, one per token and [`TURNS_OF_CLIENT`] per address,
//! so that the robots of one map do not take the turns of another. The memory that all programs may take is counted
//! together. A turn is free when it is dropped.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tidemap_base::connections::Peer;
use tidemap_map::name::MapName;

use super::memory::{self, NoMemory};

/// Maximum number of imports at a time.
const TURNS: usize = 4;
/// Maximum number of imports of one address at a time.
const TURNS_OF_CLIENT: usize = 2;
/// The advice in errors when there is no turn.
const LATER: &str = "try again when it has ended";

/// All turns. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Turns(Arc<Mutex<[Option<Holder>; TURNS]>>);

/// The holder of a turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Holder {
    pub(super) map: MapName,
    pub(super) peer: Peer,
    /// The public part of the sender's token.
    pub(super) token: Option<String>,
    /// The memory that the program may take, in bytes.
    pub(super) memory: u64,
}

/// A turn to import.
#[derive(Debug)]
pub(super) struct Turn {
    number: usize,
    memory: u64,
    turns: Turns,
}

/// The reason why there is no turn.
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

    /// Takes a turn for a sender that imports into a map.
    ///
    /// # Errors
    /// There is no turn, or the machine has no memory for the program.
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

    /// Whether any turn is taken.
    #[cfg(test)]
    pub(super) fn any(&self) -> bool {
        self.lock().iter().any(Option::is_some)
    }

    /// Does work while no turn begins or ends.
    pub(super) fn still<T>(&self, work: impl FnOnce() -> T) -> T {
        let _still = self.lock();
        work()
    }
}

impl Turn {
    /// The number of the turn: no other turn has this number meanwhile.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// The memory that the program may take, in bytes.
    pub(super) fn memory(&self) -> u64 {
        self.memory
    }

    /// All turns, including this one.
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
