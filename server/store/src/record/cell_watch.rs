//! The observation times of the groups of a tile, and the supported components of its changed cells, as messages, and
//! back.
//!
//! Invariant: every number is read back bit by bit; a value that is read has passed the constructors of the model.

use std::sync::Arc;

use tidemap_grid::observed_times::ObservedTimes;
use tidemap_layout::grid as layout;
use tidemap_model::{GapSample, OrderWatch, OrderWatchParts};

use super::{Invalid, fields};

/// Larger counts are refused, so that the sum of two never overflows.
const COUNT_MAX: u64 = 1 << 61;

pub(super) fn encode_times(times: &ObservedTimes) -> layout::GroupTimes {
    layout::GroupTimes {
        gaps: times.gaps.count(),
        kept_secs: times.gaps.kept_secs().to_vec(),
        hours_bits: times.hours.to_bits(),
        by_hour: match times.by_hour == ObservedTimes::spread(times.hours) {
            true => Vec::new(),
            false => times.by_hour.as_flattened().to_vec(),
        },
    }
}

pub(super) fn decode_times(message: &layout::GroupTimes) -> Result<Arc<ObservedTimes>, Invalid> {
    const TIMES: Invalid = "the times between the observations of a group are not valid";
    let hours = f64::from_bits(message.hours_bits);
    if message.gaps > COUNT_MAX || !(0.0..=f64::MAX).contains(&hours) {
        return Err(TIMES);
    }
    let gaps = GapSample::from_kept(message.gaps, &message.kept_secs).map_err(|_| TIMES)?;
    let by_hour = match message.by_hour.as_slice() {
        // Earlier versions stored only the number of hours.
        [] => ObservedTimes::spread(hours),
        known => {
            let (by_hour, rest) = known.as_chunks();
            let is_valid = rest.is_empty() && known.iter().all(|hours| (0.0..=f32::MAX).contains(hours));
            by_hour.try_into().ok().filter(|_| is_valid).ok_or(TIMES)?
        }
    };
    Ok(Arc::new(ObservedTimes { gaps, hours, by_hour }))
}

pub(super) fn encode_watch(watch: &OrderWatch) -> Vec<u8> {
    fields::write(watch.to_parts())
}

pub(super) fn decode_watch(message: impl AsRef<[u8]>) -> Result<OrderWatch, Invalid> {
    let parts = fields::read(OrderWatchParts::default(), message.as_ref());
    parts.and_then(OrderWatch::from_parts).map_err(|_| "the support of the components of a cell is not valid")
}
