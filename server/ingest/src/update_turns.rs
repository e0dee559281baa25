//! The turns of updates: one update computes at a time, and those of several maps take turns.
//!
//! An update that computes alone is never interrupted. Where another waits, the turn passes after [`SLICE`] to the
//! update that has computed least. So a short update ends soon, even if the others take long. Each update has threads
//! of its own, which wait between pieces of work; a piece is a local day of a state or a part of a tile.
//!
//! Invariant: at most one update has the turn, and at most [`BEGUN_MAX`] have begun and not ended: each of them holds a
//! second generation of its map. The other updates wait in the order in which they came.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// Time for which an update computes while others wait.
const SLICE: Duration = Duration::from_millis(500);

/// Maximum number of updates that have begun.
const BEGUN_MAX: usize = 8;

/// The turns of all updates of the daemon.
#[derive(Debug)]
pub struct UpdateTurns {
    state: Mutex<State>,
    changed: Condvar,
    /// Whether an update waits for its turn. While none waits, computing threads take no lock.
    is_contended: AtomicBool,
    /// Number of threads of an update.
    threads: usize,
    slice: Duration,
}

#[derive(Debug, Default)]
struct State {
    /// Number of the next update.
    next: u64,
    /// The updates that wait to begin, in order.
    arrived: VecDeque<u64>,
    /// The updates that have begun; the first has the turn.
    begun: VecDeque<Begun>,
    /// The time since which the first update has the turn.
    since: Option<Instant>,
}

#[derive(Debug)]
struct Begun {
    update: u64,
    /// The time for which the update had the turn, without its current turn.
    computed: Duration,
}

/// The place of an update among the others. It ends when it is dropped.
#[derive(Debug)]
pub struct UpdateTurn {
    turns: Arc<UpdateTurns>,
    update: u64,
}

impl UpdateTurns {
    /// `threads`: the number of threads of each update.
    pub fn new(threads: usize) -> UpdateTurns {
        UpdateTurns {
            state: Mutex::default(),
            changed: Condvar::new(),
            is_contended: AtomicBool::new(false),
            threads,
            slice: SLICE,
        }
    }

    /// Number of threads of an update.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Waits until an update may begin.
    pub fn begin(self: &Arc<Self>) -> UpdateTurn {
        let mut state = self.lock();
        let update = state.next;
        state.next += 1;
        state.arrived.push_back(update);
        state.admit();
        self.note(&state);
        let turn = UpdateTurn { turns: Arc::clone(self), update };
        self.wait_in(state, update);
        turn
    }

    /// Number of updates that wait for their turn.
    pub fn waiting(&self) -> usize {
        let state = self.lock();
        state.arrived.len() + state.begun.len().saturating_sub(1)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, state: &State) {
        self.is_contended.store(state.begun.len() > 1 || !state.arrived.is_empty(), Ordering::Relaxed);
    }

    fn wait_in(&self, state: MutexGuard<'_, State>, update: u64) {
        drop(self.changed.wait_while(state, |state| !state.has_turn(update)));
    }
}

impl State {
    fn has_turn(&self, update: u64) -> bool {
        self.begun.front().is_some_and(|first| first.update == update)
    }

    /// Lets waiting updates begin, as many as may. They have computed nothing, so they are next.
    fn admit(&mut self) {
        while self.begun.len() < BEGUN_MAX
            && let Some(update) = self.arrived.pop_front()
        {
            self.begun.push_back(Begun { update, computed: Duration::ZERO });
        }
        if !self.begun.is_empty() {
            self.since.get_or_insert_with(Instant::now);
        }
    }

    /// Passes the turn to the update that has computed least; among equal ones, to the one that has waited longest.
    fn pass(&mut self) {
        let now = Instant::now();
        let computed = self.since.map_or(Duration::ZERO, |since| now.duration_since(since));
        if let Some(mut first) = self.begun.pop_front() {
            first.computed += computed;
            self.begun.push_back(first);
        }
        self.give(now);
    }

    fn give(&mut self, now: Instant) {
        let least = (0..self.begun.len()).min_by_key(|&at| self.begun.get(at).map(|begun| begun.computed));
        if let Some(begun) = least.and_then(|at| self.begun.remove(at)) {
            self.begun.push_front(begun);
        }
        self.since = (!self.begun.is_empty()).then_some(now);
    }

    /// Ends an update.
    fn end(&mut self, update: u64) {
        let had_turn = self.has_turn(update);
        self.arrived.retain(|arrived| *arrived != update);
        self.begun.retain(|begun| begun.update != update);
        self.admit();
        if had_turn {
            self.give(Instant::now());
        }
    }
}

impl UpdateTurn {
    /// Returns at once while the update has the turn, and passes it on where another waits and the slice is over.
    pub fn wait(&self) {
        let turns = &self.turns;
        if !turns.is_contended.load(Ordering::Relaxed) {
            return;
        }
        let mut state = turns.lock();
        if state.has_turn(self.update) {
            let is_over = state.since.is_none_or(|since| since.elapsed() >= turns.slice);
            if !is_over || state.begun.len() < 2 {
                return;
            }
            state.pass();
            turns.changed.notify_all();
        }
        turns.wait_in(state, self.update);
    }
}

impl Drop for UpdateTurn {
    fn drop(&mut self) {
        let mut state = self.turns.lock();
        state.end(self.update);
        self.turns.note(&state);
        self.turns.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::{Arc, Mutex, mpsc},
        thread,
    };

    use super::*;

    fn turns(slice: Duration) -> Arc<UpdateTurns> {
        Arc::new(UpdateTurns { slice, ..UpdateTurns::new(1) })
    }

    #[test]
    fn an_update_alone_never_waits() {
        let turns = turns(Duration::ZERO);
        let turn = turns.begin();
        for _ in 0..1_000 {
            turn.wait();
        }
        assert_eq!(turns.waiting(), 0);
    }

    #[test]
    fn a_short_update_ends_while_a_long_one_goes_on() {
        let turns = turns(Duration::ZERO);
        let long = turns.begin();
        let (ended, short_ended) = mpsc::channel();
        let short = thread::spawn({
            let turns = Arc::clone(&turns);
            move || {
                let turn = turns.begin();
                (0..3).for_each(|_| turn.wait());
                ended.send(()).expect("the test listens");
            }
        });
        // The long update would never end by itself: it ends after the short one.
        while short_ended.try_recv().is_err() {
            long.wait();
            thread::yield_now();
        }
        short.join().expect("no panic");
        assert_eq!(turns.waiting(), 0);
    }

    #[test]
    fn one_update_computes_at_a_time_and_no_more_begin_than_may() {
        let turns = turns(Duration::ZERO);
        let (computing, begun) = (Arc::new(Mutex::new(())), Arc::new(Mutex::new((0_usize, 0_usize))));
        let updates = (0..3 * BEGUN_MAX).map(|_| {
            let (turns, computing, begun) = (Arc::clone(&turns), Arc::clone(&computing), Arc::clone(&begun));
            thread::spawn(move || {
                let turn = turns.begin();
                {
                    let mut begun = begun.lock().expect("no panic");
                    begun.0 += 1;
                    begun.1 = begun.1.max(begun.0);
                }
                for _ in 0..20 {
                    turn.wait();
                    let alone = computing.try_lock().expect("another update computes");
                    thread::yield_now();
                    drop(alone);
                }
                begun.lock().expect("no panic").0 -= 1;
            })
        });
        let updates: Vec<_> = updates.collect();
        updates.into_iter().for_each(|update| update.join().expect("no panic"));
        assert!(begun.lock().expect("no panic").1 <= BEGUN_MAX);
        assert_eq!(turns.waiting(), 0);
    }

    #[test]
    fn the_turn_goes_to_the_update_that_has_computed_least() {
        let mut state = State::default();
        state.arrived.extend([1, 2, 3]);
        state.admit();
        assert!(state.has_turn(1));
        state.begun.iter_mut().for_each(|begun| begun.computed = Duration::from_secs(10 - begun.update));
        state.pass();
        assert!(state.has_turn(3));
        state.end(3);
        assert!(state.has_turn(2));
        state.arrived.push_back(4);
        state.admit();
        state.pass();
        assert!(state.has_turn(4), "a new update has computed nothing");
    }
}
