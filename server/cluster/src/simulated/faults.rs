//! The faults between a client and the simulated engine, and in the engine: how often they occur, and for how long.
//!
//! Invariant: faults are drawn from the generator of the world alone, so that a seed fixes all of them.

use std::{ops::RangeInclusive, time::Duration};

use rand::{Rng, rngs::SmallRng};

/// A fault of the simulated engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum EngineFault {
    /// The request is lost: it has no effect, and no reply comes.
    RequestLost,
    /// The reply is lost: the request has its effect.
    ReplyLost,
    /// The request has its effect after its sender has given up.
    Late,
    /// There is no leader for a while.
    NoLeader,
    /// The client of a call is cut off for a while.
    CutOff,
    /// A stream has no room for a while.
    Full,
    /// A stream forgets its last messages, and uses their numbers again.
    Amnesia,
    /// For a while the client of a call has a stream of its own, which acknowledges and is then forgotten; the other
    /// clients go on with the common stream.
    Split,
    /// A server stops for a while. The streams that it leads have no leader until one is elected.
    ServerStopped,
}

impl EngineFault {
    /// All faults.
    pub const ALL: [Self; 9] = [
        Self::RequestLost,
        Self::ReplyLost,
        Self::Late,
        Self::NoLeader,
        Self::CutOff,
        Self::Full,
        Self::Amnesia,
        Self::Split,
        Self::ServerStopped,
    ];
}

/// The frequency of faults, as probabilities of a call, and their duration.
#[derive(Clone, Debug)]
pub struct EngineFaults {
    /// Time for which a request is under way, and also its reply. A wide range lets concurrent calls overtake each
    /// other.
    pub delay: RangeInclusive<Duration>,
    /// Faults that are drawn at each call, with their probabilities.
    pub chances: Vec<(EngineFault, f64)>,
    /// Duration of a cut, a full stream, a split or a stopped server.
    pub lasts: RangeInclusive<Duration>,
    /// Duration of an election.
    pub election: RangeInclusive<Duration>,
    /// Number of messages that amnesia removes.
    pub forgets: RangeInclusive<u64>,
}

impl EngineFaults {
    /// No faults, and the delays of a rack.
    pub fn none() -> Self {
        Self {
            delay: Duration::from_micros(200)..=Duration::from_millis(4),
            chances: Vec::new(),
            lasts: Duration::from_millis(200)..=Duration::from_secs(8),
            election: Duration::from_secs(4)..=Duration::from_secs(9),
            forgets: 1..=5,
        }
    }

    /// Faults that a quorum survives: no acknowledged message is lost.
    pub fn survivable() -> Self {
        let chances = vec![
            (EngineFault::RequestLost, 0.02),
            (EngineFault::ReplyLost, 0.02),
            (EngineFault::Late, 0.01),
            (EngineFault::NoLeader, 0.002),
            (EngineFault::CutOff, 0.005),
            (EngineFault::Full, 0.002),
            (EngineFault::ServerStopped, 0.002),
        ];
        Self { delay: Duration::from_micros(200)..=Duration::from_millis(30), chances, ..Self::none() }
    }

    /// All faults: acknowledged messages may be lost.
    pub fn all() -> Self {
        let mut faults = Self::survivable();
        faults.chances.extend([(EngineFault::Amnesia, 0.002), (EngineFault::Split, 0.002)]);
        faults
    }
}

/// A duration within a range.
pub(super) fn draw(rng: &mut SmallRng, range: &RangeInclusive<Duration>) -> Duration {
    let micros = |duration: &Duration| u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
    Duration::from_micros(rng.random_range(micros(range.start())..=micros(range.end())))
}
