//! The recent readings of a state of two values, in constant memory: the newest ones one by one, earlier ones in spans
//! between which the state seems to have changed.
//!
//! This is what an observation changes at once. It holds no learned parameter, so that an update changes nothing here,
//! and the same readings in the same order always give the same spans. Invariant: spans are ascending and do not
//! overlap, each has a reading, and the newest is a single reading.

use crate::InvalidParts;

/// Maximum number of spans of a state.
pub const SPANS_MAX: usize = 16;
/// The newest readings, which are not merged.
const SINGLE: usize = 5;
/// A boundary that makes the readings on its sides more likely by this many nats is a change, not a wrong reading.
const CHANGE_NATS: f64 = 6.0;
/// The weight of a boundary, against that of the next newer one.
const KEPT_PER_BOUNDARY: f64 = 0.5;
/// With this many changes, earlier readings say nothing new.
const CHANGES: usize = 4;

/// Readings of a state between two times, which seem to be of one true value.
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

    /// How much less likely the readings of both spans are with one share of ones instead of two, in nats.
    fn loss(&self, next: &RecentSpan) -> f64 {
        let log_likelihood = |ones: f64, zeros: f64| {
            let part = |count: f64| if count > 0.0 { count * (count / (ones + zeros)).ln() } else { 0.0 };
            part(ones) + part(zeros)
        };
        let (ones, zeros) = (f64::from(self.ones), f64::from(self.zeros));
        let (next_ones, next_zeros) = (f64::from(next.ones), f64::from(next.zeros));
        log_likelihood(ones, zeros) + log_likelihood(next_ones, next_zeros)
            - log_likelihood(ones + next_ones, zeros + next_zeros)
    }
}

/// The recent readings of a state; see the top of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Recent {
    spans: [RecentSpan; SPANS_MAX],
    len: u8,
}

impl Recent {
    /// Takes in a reading. One that is not newer than the last one changes nothing, nor does another value than 0 or 1.
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        let is_newer = self.newest_nanos().is_none_or(|newest| utc_nanos > newest);
        if !is_newer || (value != 0.0 && value != 1.0) {
            return;
        }
        if usize::from(self.len) == SPANS_MAX {
            self.make_room();
        }
        let is_one = value == 1.0;
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
    /// [`InvalidParts`] where they are too many, overlap or have no readings, or the newest is not a single reading.
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
    /// known without it.
    fn make_room(&mut self) {
        let earlier = &self.spans[..SPANS_MAX - SINGLE];
        let losses = earlier.windows(2).map(|pair| pair[0].loss(&pair[1]));
        let changes = losses.clone().filter(|&loss| loss >= CHANGE_NATS).count();
        let faded = |(index, loss): (usize, f64)| loss * KEPT_PER_BOUNDARY.powi((earlier.len() - 2 - index) as i32);
        let least = losses
            .enumerate()
            .map(faded)
            .enumerate()
            .min_by(|one, other| one.1.total_cmp(&other.1))
            .map_or(0, |(index, _)| index);
        let merged = earlier[least].merged(&earlier[least + 1]).filter(|_| changes < CHANGES);
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
    }
}
