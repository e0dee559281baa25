//! The clock of a robot: its stamps go on as the recorder's clock goes on, until it is set back or a simulation is
//! started again.
//!
//! Invariant: one part of a recording is taken, the one with the most messages: stamps of another part may be the same.

use std::collections::HashMap;

use crate::frames::Frames;

/// Stamps of one source that go back by more than this mean that the clock went back, nanoseconds.
const MOMENT_NANOS: i64 = 1_000_000_000;
/// Maximum number of sources that are watched.
const SOURCES_MAX: usize = 10_000;

/// The part of a recording that is taken because the robot's clock went back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TakenPart {
    /// How often the clock went back.
    pub times_back: u64,
    /// The longest way that it went back, nanoseconds.
    pub back_nanos: i64,
    /// The part begins at this time of recording, nanoseconds since 1970.
    pub from_nanos: i64,
    /// The part ends before this time of recording.
    pub to_nanos: i64,
}

impl TakenPart {
    /// Whether a message was recorded within the part.
    pub fn contains(&self, recorded_nanos: i64) -> bool {
        (self.from_nanos..self.to_nanos).contains(&recorded_nanos)
    }
}

/// A part of a recording within which the clock goes on.
#[derive(Debug)]
struct ClockPart {
    from_nanos: i64,
    to_nanos: i64,
    messages: u64,
    frames: Frames,
}

/// Watches the stamps of a recording.
#[derive(Debug)]
pub(super) struct RobotClock {
    /// The latest stamp of each source, and when it was recorded.
    latest: HashMap<String, (i64, i64)>,
    from_nanos: i64,
    messages: u64,
    best: Option<ClockPart>,
    times_back: u64,
    back_nanos: i64,
}

impl Default for RobotClock {
    fn default() -> Self {
        let latest = HashMap::new();
        Self { latest, from_nanos: i64::MIN, messages: 0, best: None, times_back: 0, back_nanos: 0 }
    }
}

impl RobotClock {
    /// Takes a stamp of a source. If the clock went back, `frames` begins anew with the static transforms.
    pub(super) fn stamped(&mut self, source: &str, stamp_nanos: i64, recorded_nanos: i64, frames: &mut Frames) {
        self.messages += 1;
        let has_place = self.latest.len() < SOURCES_MAX;
        match self.latest.get_mut(source) {
            Some((latest, recorded)) if stamp_nanos >= *latest => (*latest, *recorded) = (stamp_nanos, recorded_nanos),
            Some((latest, recorded)) => {
                // A file that was recorded before the others is no clock that goes back.
                let back_nanos = latest.saturating_sub(stamp_nanos);
                if back_nanos > MOMENT_NANOS && recorded_nanos >= *recorded {
                    self.times_back += 1;
                    self.back_nanos = self.back_nanos.max(back_nanos);
                    let next = frames.without_moving();
                    self.end_part(recorded_nanos, std::mem::replace(frames, next));
                    self.from_nanos = recorded_nanos;
                    self.latest.clear();
                    self.latest.insert(source.to_owned(), (stamp_nanos, recorded_nanos));
                }
            }
            None if has_place => {
                self.latest.insert(source.to_owned(), (stamp_nanos, recorded_nanos));
            }
            None => {}
        }
    }

    fn end_part(&mut self, to_nanos: i64, frames: Frames) {
        let messages = std::mem::take(&mut self.messages);
        if self.best.as_ref().is_none_or(|best| best.messages < messages) {
            self.best = Some(ClockPart { from_nanos: self.from_nanos, to_nanos, messages, frames });
        }
    }

    /// Chooses the part with the most messages, and leaves its transforms in `frames`.
    pub(super) fn finish(mut self, frames: &mut Frames) -> Option<TakenPart> {
        if self.times_back == 0 {
            return None;
        }
        self.end_part(i64::MAX, std::mem::take(frames));
        let ClockPart { from_nanos, to_nanos, frames: taken, .. } = self.best?;
        *frames = taken;
        Some(TakenPart { times_back: self.times_back, back_nanos: self.back_nanos, from_nanos, to_nanos })
    }
}
