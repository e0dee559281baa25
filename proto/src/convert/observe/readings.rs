//! Single readings, as the columns of a message.
//!
//! Invariant: the columns have the readings in their order, and each name once.

use std::collections::HashMap;

use crate::{
    convert::{InvalidField, time::nanos_from_timestamp},
    v1,
};

/// A state as the batch names it.
struct Named {
    index: u32,
    kind: v1::StateKind,
    dimensions: u32,
}

/// The columns of the readings of a report, whose default time is `now_nanos`, nanoseconds UTC.
///
/// # Errors
/// The invalid field, or there are no readings.
pub fn readings_to_columns(readings: &[v1::Reading], now_nanos: i64) -> Result<v1::ObservationColumns, InvalidField> {
    if readings.is_empty() {
        return Err(InvalidField::new("readings", "there is none: send at least one"));
    }
    let mut columns = v1::ObservationColumns { time_unit_nanos: 1, ..Default::default() };
    let mut named: HashMap<&str, Named> = HashMap::new();
    let mut before = None;
    for (i, reading) in readings.iter().enumerate() {
        let field = |name: &str| format!("readings[{i}].{name}");
        let time = reading.time.map_or(Ok(now_nanos), |time| nanos_from_timestamp(&field("time"), time))?;
        let dimensions = u32::try_from(reading.position.len()).unwrap_or(u32::MAX);
        if !matches!(dimensions, 0 | 2 | 3) {
            let text = format!("{dimensions} coordinates: a position has 2 or 3");
            return Err(InvalidField::new(field("position"), text));
        }
        let kind = match reading.kind() {
            v1::StateKind::Unspecified if dimensions > 0 => v1::StateKind::Vector,
            kind => kind,
        };
        let next = u32::try_from(named.len()).unwrap_or(u32::MAX);
        let state = named.entry(&reading.state).or_insert_with(|| {
            columns.new_states.push(reading.state.clone());
            columns.new_kinds.push(kind.into());
            columns.new_dimensions.push(dimensions);
            Named { index: next, kind, dimensions }
        });
        if state.kind != kind || state.dimensions != dimensions {
            let text = "all readings of a state have the same kind and number of coordinates";
            return Err(InvalidField::new(field("kind"), text));
        }
        columns.state_indices.push(state.index);
        let delta = time - *before.get_or_insert(time);
        before = Some(time);
        columns.first_time_nanos = if i == 0 { time } else { columns.first_time_nanos };
        columns.time_deltas.push(delta);
        columns.values.push(reading.value);
        columns.coordinates.extend_from_slice(&reading.position);
    }
    if columns.new_dimensions.iter().all(|dimensions| *dimensions == 0) {
        columns.new_dimensions.clear();
    }
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::{columns, time::timestamp};

    fn reading(state: &str, value: f64) -> v1::Reading {
        v1::Reading { state: state.to_owned(), value, ..v1::Reading::default() }
    }

    #[test]
    fn readings_become_columns_in_their_order() {
        let late = v1::Reading { time: Some(timestamp(9)), ..reading("door", 0.0) };
        let packed = readings_to_columns(&[reading("door", 1.0), reading("lamp", 0.5), late], 7).expect("right");
        assert_eq!(packed.new_states, ["door", "lamp"]);
        let unpacked = columns::decode(packed).expect("well formed");
        assert_eq!((unpacked.times_nanos, unpacked.state_indices), (vec![7, 7, 9], vec![0, 1, 0]));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |readings: &[v1::Reading]| readings_to_columns(readings, 7).expect_err("wrong").field;
        assert_eq!(field(&[]), "readings");
        let placed = |position: &[f64]| v1::Reading { position: position.to_vec(), ..reading("anna", 0.0) };
        assert_eq!(field(&[placed(&[1.0])]), "readings[0].position");
        assert_eq!(field(&[placed(&[1.0, 2.0]), reading("anna", 1.0)]), "readings[1].kind");
        assert_eq!(field(&[v1::Reading { time: Some(timestamp(-1)), ..reading("door", 1.0) }]), "readings[0].time");
    }
}
