//! The recent readings of a state of two values, in constant memory: the newest ones one by one, earlier ones in spans
//! between which the state seems to have changed.
//!
//! An observation changes this data at once. It has no learned parameter, so that an update changes nothing here, and
//! the same readings in the same order always give the same spans. Invariant: spans are ascending and do not overlap,
//! each has a reading, and the newest is a single reading.

use std::sync::LazyLock;

use crate::InvalidParts;

/// Maximum number of spans of a state.
pub const SPANS_MAX: usize = 16;
/// This many of the newest readings are not merged.
const SINGLE: usize = 5;
/// Number of spans that may be merged.
const EARLIER: usize = SPANS_MAX - SINGLE;
/// A boundary that makes the readings on its sides more likely by this many nats is a change, not a wrong reading.
const CHANGE_NATS: f64 = 6.0;
/// The weight of a boundary, against that of the next newer one.
const KEPT_PER_BOUNDARY: f64 = 0.5;
/// For counts below this, x·ln x is in a table: enough for a reading each minute of a day.
const TABLED: usize = 2048;
/// With this many changes, earlier readings add no information.
const CHANGES: usize = 4;

/// Readings of a state between two times, between which its true value seems to be constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct RecentSpan {
    /// UTC nanoseconds of the first reading.
    pub first_nanos: i64,
    /// Milliseconds from the first reading to the last, rounded down.
    pub length_millis: u32,
    /// Readings of 1; of more than 65,535 readings the share is kept.
    pub ones: u16,
    /// Readings of 0.
    pub zeros: u16,
}

impl RecentSpan {
    /// UTC nanoseconds of the last reading, to a millisecond.
    pub(super) fn last_nanos(&self) -> i64 {
        self.first_nanos.saturating_add(i64::from(self.length_millis) * 1_000_000)
    }

    pub(super) fn secs(&self) -> f64 {
        f64::from(self.length_millis) / 1e3
    }

    /// This and the next span as one; `None` if it would be longer than can be stored.
    fn merged(&self, next: &RecentSpan) -> Option<RecentSpan> {
        let millis = next.last_nanos().abs_diff(self.first_nanos) / 1_000_000;
        let (mut ones, mut zeros) =
            (u32::from(self.ones) + u32::from(next.ones), u32::from(self.zeros) + u32::from(next.zeros));
        while ones.max(zeros) > u32::from(u16::MAX) {
            (ones, zeros) = (ones.div_ceil(2), zeros.div_ceil(2));
        }
        Some(RecentSpan {
            first_nanos: self.first_nanos,
            length_millis: u32::try_from(millis).ok()?,
            // Both fit by the loop above.
            ones: ones as u16,
            zeros: zeros as u16,
        })
    }

    /// The log-likelihood that the readings of both spans lose with one share of ones instead of two, in nats.
    fn loss(&self, next: &RecentSpan) -> f64 {
        if self.ones | next.ones == 0 || self.zeros | next.zeros == 0 {
            return 0.0;
        }
        let log_likelihood = |ones: u32, zeros: u32| x_ln_x(ones) + x_ln_x(zeros) - x_ln_x(ones + zeros);
        let (ones, zeros) = (u32::from(self.ones), u32::from(self.zeros));
        let (next_ones, next_zeros) = (u32::from(next.ones), u32::from(next.zeros));
        log_likelihood(ones, zeros) + log_likelihood(next_ones, next_zeros)
            - log_likelihood(ones + next_ones, zeros + next_zeros)
    }
}

/// x·ln x, from a table where x is small: each reading needs dozens.
fn x_ln_x(x: u32) -> f64 {
    static TABLE: LazyLock<[f64; TABLED]> = LazyLock::new(|| std::array::from_fn(|x| exactly(x as u32)));
    fn exactly(x: u32) -> f64 {
        let x = f64::from(x);
        if x > 0.0 { x * libm::log(x) } else { 0.0 }
    }
    TABLE.get(x as usize).copied().unwrap_or_else(|| exactly(x))
}

/// The recent readings of a state; see the top of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Recent {
    spans: [RecentSpan; SPANS_MAX],
    len: u8,
}

impl Recent {
    /// Adds a reading. A reading that is not newer than the last one changes nothing, nor does another value than 0 or
    /// 1.
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        let is_newer = self.newest_nanos().is_none_or(|newest| utc_nanos > newest);
        if !is_newer || (value != 0.0 && value != 1.0) {
            return;
        }
        if usize::from(self.len) == SPANS_MAX {
            let losses = std::array::from_fn(|index| self.spans[index].loss(&self.spans[index + 1]));
            self.make_room(&losses);
        }
        self.push(utc_nanos, value == 1.0);
    }

    /// Adds a reading where there is room.
    fn push(&mut self, utc_nanos: i64, is_one: bool) {
        let (ones, zeros) = (u16::from(is_one), u16::from(!is_one));
        if let Some(free) = self.spans.get_mut(usize::from(self.len)) {
            *free = RecentSpan { first_nanos: utc_nanos, length_millis: 0, ones, zeros };
            self.len += 1;
        }
    }

    /// The spans, ascending.
    pub fn spans(&self) -> &[RecentSpan] {
        self.spans.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// UTC nanoseconds of the newest reading.
    pub fn newest_nanos(&self) -> Option<i64> {
        self.spans().last().map(|span| span.first_nanos)
    }

    /// The recent readings from stored spans.
    ///
    /// # Errors
    /// [`InvalidParts`] where the spans are too many, overlap or have no readings, or the newest is not a single
    /// reading.
    pub fn from_spans(spans: &[RecentSpan]) -> Result<Recent, InvalidParts> {
        let ascending = spans.is_sorted_by(|one, next| one.last_nanos() < next.first_nanos);
        let filled = spans.iter().all(|span| span.ones > 0 || span.zeros > 0);
        let single = spans.last().is_none_or(|span| span.length_millis == 0);
        if spans.len() > SPANS_MAX || !ascending || !filled || !single {
            return Err(InvalidParts::OutOfRange { field: "spans of recent readings", found: spans.len() as f64 });
        }
        let mut recent = Recent { len: spans.len() as u8, ..Recent::default() };
        recent.spans.iter_mut().zip(spans).for_each(|(to, from)| *to = *from);
        Ok(recent)
    }

    /// Frees a place: merges the two neighbours that differ least, or forgets the oldest span where enough changes are
    /// known without it. `losses`: the loss of merging each span that may be merged with the next one. Returns the
    /// index of the span that was merged with the next one; `None` if the oldest was forgotten.
    fn make_room(&mut self, losses: &[f64; EARLIER - 1]) -> Option<usize> {
        let changes = losses.iter().filter(|&&loss| loss >= CHANGE_NATS).count();
        let (mut least, mut least_loss, mut weight) = (0, f64::INFINITY, 1.0);
        // From the newest boundary to the oldest; of two with equal losses, the older one is removed.
        for (index, loss) in losses.iter().enumerate().rev() {
            if loss * weight <= least_loss {
                (least, least_loss) = (index, loss * weight);
            }
            weight *= KEPT_PER_BOUNDARY;
        }
        let merged = self.spans[least].merged(&self.spans[least + 1]).filter(|_| changes < CHANGES);
        let gone = match merged {
            Some(merged) => {
                self.spans[least] = merged;
                least + 1
            }
            None => 0,
        };
        self.spans.copy_within(gone + 1.., gone);
        self.spans[SPANS_MAX - 1] = RecentSpan::default();
        self.len -= 1;
        gone.checked_sub(1)
    }
}

/// Adds many readings, as [`Recent::observe`] does one by one, and keeps the losses of the spans meanwhile.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecentReplay {
    recent: Recent,
    losses: [f64; SPANS_MAX - 1],
}

impl RecentReplay {
    pub(super) fn new(recent: Recent) -> RecentReplay {
        let losses = std::array::from_fn(|index| recent.spans[index].loss(&recent.spans[index + 1]));
        RecentReplay { recent, losses }
    }

    /// The readings so far.
    pub(super) fn recent(&self) -> &Recent {
        &self.recent
    }

    /// See [`Recent::observe`].
    pub(super) fn observe(&mut self, utc_nanos: i64, value: f64) {
        let recent = &mut self.recent;
        if recent.newest_nanos().is_some_and(|newest| utc_nanos <= newest) || (value != 0.0 && value != 1.0) {
            return;
        }
        if usize::from(recent.len) == SPANS_MAX
            && let Some(losses) = self.losses.first_chunk()
        {
            let merged = recent.make_room(losses);
            self.losses.copy_within(merged.map_or(1, |merged| merged + 1).., merged.unwrap_or(0));
            for changed in merged.into_iter().flat_map(|merged| [merged.checked_sub(1), Some(merged)]).flatten() {
                self.losses[changed] = recent.spans[changed].loss(&recent.spans[changed + 1]);
            }
        }
        recent.push(utc_nanos, value == 1.0);
        if let Some(last) = usize::from(recent.len).checked_sub(2) {
            self.losses[last] = recent.spans[last].loss(&recent.spans[last + 1]);
        }
    }
}
