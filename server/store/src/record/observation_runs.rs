//! The observation times of those cells of a tile that have no sums for them, as messages, and back.
//!
//! Invariant: a value that is read has passed the constructor of the domain again, and is as large as its bytes, except
//! for times at equal distances.

use std::sync::Arc;

use tidemap_grid::observation_runs::{CellRuns, DayRuns, ObservationRuns};
use tidemap_layout::grid as layout;

use super::{
    Invalid, columns, sensors,
    varint::{push_varint, take_u32, take_varint, unzigzag, zigzag},
};

/// Limit of the number of scans of a day.
const SCANS_MAX: u32 = 1 << 26;
const INVALID: Invalid = "the runs in which cells were observed are not valid";

pub(crate) fn encode(runs: &ObservationRuns) -> Result<Vec<layout::SeenDay>, Invalid> {
    runs.days().iter().map(encode_day).collect()
}

fn encode_day(day: &DayRuns) -> Result<layout::SeenDay, Invalid> {
    let scans = u32::try_from(day.civil_nanos.len()).ok().filter(|&scans| (1..=SCANS_MAX).contains(&scans));
    // Times may lie at the ends of i64.
    let differences: Vec<i64> = day.civil_nanos.windows(2).map(|pair| pair[1].wrapping_sub(pair[0])).collect();
    let unit = columns::unit(&differences);
    let times = columns::encode_numbers(&differences, |difference| zigzag(difference / unit));
    let mut lists = Vec::new();
    for list in &day.lists {
        push_gaps(&mut lists, list.cells.iter().map(|&cell| u32::from(cell)))?;
        push_gaps(&mut lists, list.toggles.iter().copied())?;
    }
    let of_scans = day.sensors.as_deref().map_or(&[][..], Vec::as_slice);
    let (sensor_counts, sensor_numbers) = sensors::encode_runs(of_scans.iter().copied());
    Ok(layout::SeenDay {
        scans: scans.ok_or("a day has more scans than it may have")?,
        first_civil_nanos: day.civil_nanos.first().copied().unwrap_or(0),
        time_unit_nanos: unit.unsigned_abs(),
        times,
        lists,
        sensor_counts,
        sensors: sensor_numbers,
    })
}

fn push_gaps(out: &mut Vec<u8>, numbers: impl ExactSizeIterator<Item = u32>) -> Result<(), Invalid> {
    push_varint(out, numbers.len() as u64);
    let mut next = 0;
    for number in numbers {
        push_varint(out, u64::from(number).checked_sub(next).ok_or(INVALID)?);
        next = u64::from(number) + 1;
    }
    Ok(())
}

pub(crate) fn decode(days: &[layout::SeenDay]) -> Result<ObservationRuns, Invalid> {
    let days = days.iter().map(decode_day).collect::<Result<_, _>>()?;
    ObservationRuns::from_days(days).map_err(|_| INVALID)
}

fn decode_day(message: &layout::SeenDay) -> Result<DayRuns, Invalid> {
    if !(1..=SCANS_MAX).contains(&message.scans) {
        return Err(INVALID);
    }
    let unit = i64::try_from(message.time_unit_nanos).map_err(|_| INVALID)?;
    let mut now = message.first_civil_nanos;
    let differences =
        columns::decode_numbers(&message.times, message.scans as usize - 1, |number| Ok(unzigzag(number)))?;
    let mut civil_nanos = Vec::with_capacity(message.scans as usize);
    civil_nanos.push(now);
    for difference in differences {
        now = now.wrapping_add(difference.wrapping_mul(unit));
        civil_nanos.push(now);
    }
    let mut lists = Vec::new();
    let mut bytes = &message.lists[..];
    while !bytes.is_empty() {
        let cells = take_gaps(&mut bytes)?;
        let cells = cells.into_iter().map(|cell| u16::try_from(cell).map_err(|_| INVALID)).collect::<Result<_, _>>()?;
        lists.push(CellRuns { cells, toggles: take_gaps(&mut bytes)?.into() });
    }
    let of_scans = sensors::decode_runs(&message.sensor_counts, &message.sensors, civil_nanos.len())?;
    Ok(DayRuns { civil_nanos: civil_nanos.into(), sensors: of_scans.map(Arc::new), lists })
}

fn take_gaps(bytes: &mut &[u8]) -> Result<Vec<u32>, Invalid> {
    let count = take_u32(bytes)? as usize;
    // Each number takes at least one byte.
    if count > bytes.len() {
        return Err(INVALID);
    }
    let mut numbers = Vec::with_capacity(count);
    let mut next = 0_u64;
    for _ in 0..count {
        let number =
            next.checked_add(take_varint(bytes)?).and_then(|number| u32::try_from(number).ok()).ok_or(INVALID)?;
        numbers.push(number);
        next = u64::from(number) + 1;
    }
    Ok(numbers)
}
