//! Single readings, as the observations of a message.
//!
//! Invariant: the columns have the readings in their order, and each name once.

use std::{borrow::Cow, collections::HashMap};

use tidemap_map::name::StateName;

use super::UnnumberedObservations;
use crate::{
    convert::{InvalidField, classify::Learning, time::nanos_from_timestamp},
    v1,
};

/// A state as the batch names it.
struct Named {
    index: u32,
    kind: v1::StateKind,
    dimensions: u32,
}

/// The readings of a request, whose default time is `now_nanos`, nanoseconds UTC.
///
/// # Errors
/// The invalid field, or there are no readings.
pub fn readings_from_wire(readings: &[v1::Reading], now_nanos: i64) -> Result<UnnumberedObservations, InvalidField> {
    columns_of(readings, now_nanos).map(UnnumberedObservations)
}

/// The observations by which a classification is learned, of each of these categorical states at a time, nanoseconds
/// UTC: the likeliest label, or the share of each label. `shares`: the labels in their order.
#[must_use]
pub fn learned_readings(
    states: &[StateName],
    utc_nanos: i64,
    learning: Learning,
    shares: &[(String, f64)],
) -> UnnumberedObservations {
    let likeliest = shares.iter().max_by(|(_, one), (_, other)| one.total_cmp(other));
    let likeliest = likeliest.filter(|_| learning != Learning::Shares).map(|(label, _)| label);
    let count = states.len();
    let name = |state: &StateName| likeliest.map_or_else(|| state.to_string(), |label| format!("{state}/{label}"));
    let mut columns = v1::ObservationColumns {
        time_unit_nanos: 1,
        first_time_nanos: utc_nanos,
        time_deltas: vec![0; count],
        state_indices: (0..u32::try_from(count).unwrap_or(u32::MAX)).collect(),
        new_states: states.iter().map(name).collect(),
        new_kinds: vec![v1::StateKind::Categorical.into(); count],
        values: vec![if likeliest.is_some() { 1.0 } else { 0.0 }; count],
        ..v1::ObservationColumns::default()
    };
    if likeliest.is_none() {
        columns.new_dimensions = vec![u32::try_from(shares.len()).unwrap_or(u32::MAX); count];
        columns.shares = states.iter().flat_map(|_| shares.iter().map(|(_, share)| *share)).collect();
    }
    UnnumberedObservations(columns)
}

fn columns_of(readings: &[v1::Reading], now_nanos: i64) -> Result<v1::ObservationColumns, InvalidField> {
    if readings.is_empty() {
        return Err(InvalidField::new("readings", "there is none: send at least one"));
    }
    let mut columns = v1::ObservationColumns { time_unit_nanos: 1, ..Default::default() };
    let mut named: HashMap<Cow<'_, str>, Named> = HashMap::new();
    let mut before = None;
    for (i, reading) in readings.iter().enumerate() {
        let field = |name: &str| format!("readings[{i}].{name}");
        let time = reading.time.map_or(Ok(now_nanos), |time| nanos_from_timestamp(&field("time"), time))?;
        let dimensions = u32::try_from(reading.position.len()).unwrap_or(u32::MAX);
        if !matches!(dimensions, 0 | 2 | 3) {
            let text = format!("{dimensions} coordinates: a position has 2 or 3");
            return Err(InvalidField::new(field("position"), text));
        }
        let labels = u32::try_from(reading.shares.len()).unwrap_or(u32::MAX);
        let is_categorical = labels > 0 || !reading.label.is_empty();
        if is_categorical && dimensions > 0 || labels > 0 && !reading.label.is_empty() {
            return Err(InvalidField::new(
                field("label"),
                "a reading has a value, a position, a label or shares: one of these",
            ));
        }
        let kind = match reading.kind() {
            v1::StateKind::Unspecified if dimensions > 0 => v1::StateKind::Vector,
            v1::StateKind::Unspecified if is_categorical => v1::StateKind::Categorical,
            v1::StateKind::Categorical if !is_categorical => {
                return Err(InvalidField::new(
                    field("label"),
                    "a reading of a categorical state has a label or shares",
                ));
            }
            kind if is_categorical && kind != v1::StateKind::Categorical => {
                return Err(InvalidField::new(field("kind"), "only a categorical state has a label or shares"));
            }
            kind => kind,
        };
        let dimensions = dimensions.max(labels);
        let name = match reading.label.as_str() {
            "" => Cow::from(&reading.state),
            label => Cow::from(format!("{}/{label}", reading.state)),
        };
        let next = u32::try_from(named.len()).unwrap_or(u32::MAX);
        let state = named.entry(name.clone()).or_insert_with(|| {
            columns.new_states.push(name.into_owned());
            columns.new_kinds.push(kind.into());
            columns.new_dimensions.push(dimensions);
            Named { index: next, kind, dimensions }
        });
        if state.kind != kind || state.dimensions != dimensions {
            let text = "all readings of a state have the same kind and number of coordinates or shares";
            return Err(InvalidField::new(field("kind"), text));
        }
        columns.state_indices.push(state.index);
        let delta = time - *before.get_or_insert(time);
        before = Some(time);
        columns.first_time_nanos = if i == 0 { time } else { columns.first_time_nanos };
        columns.time_deltas.push(delta);
        columns.values.push(if reading.label.is_empty() { reading.value } else { 1.0 });
        columns.coordinates.extend_from_slice(&reading.position);
        columns.shares.extend_from_slice(&reading.shares);
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
        let packed = columns_of(&[reading("door", 1.0), reading("lamp", 0.5), late], 7).expect("right");
        assert_eq!(packed.new_states, ["door", "lamp"]);
        let unpacked = columns::decode(packed).expect("well formed");
        assert_eq!((unpacked.times_nanos, unpacked.state_indices), (vec![7, 7, 9], vec![0, 1, 0]));
    }

    #[test]
    fn a_label_is_a_name_of_its_own_and_shares_have_their_number() {
        let label = |label: &str| v1::Reading { label: label.to_owned(), ..reading("activity", 0.0) };
        let shares = v1::Reading { shares: vec![0.25, 0.75], ..reading("mood", 0.0) };
        let packed = columns_of(&[label("eat"), label("sleep"), label("eat"), shares], 7).expect("right");
        assert_eq!(packed.new_states, ["activity/eat", "activity/sleep", "mood"]);
        assert_eq!(packed.new_kinds, [i32::from(v1::StateKind::Categorical); 3]);
        assert_eq!((packed.new_dimensions, packed.shares), (vec![0, 0, 2], vec![0.25, 0.75]));
        assert_eq!((packed.state_indices, packed.values), (vec![0, 1, 0, 2], vec![1.0, 1.0, 1.0, 0.0]));
    }

    #[test]
    fn a_classification_is_learned_as_its_likeliest_label_or_as_shares() {
        let shares = [("sleep".to_owned(), 0.25), ("eat".to_owned(), 0.75)];
        let states = [StateName::new("activity").expect("valid")];
        let UnnumberedObservations(label) = learned_readings(&states, 7, Learning::Label, &shares);
        let sent = v1::Reading { label: "eat".to_owned(), ..reading("activity", 0.0) };
        assert_eq!(label, columns_of(&[sent], 7).expect("valid"));
        let UnnumberedObservations(whole) = learned_readings(&states, 7, Learning::Shares, &shares);
        let sent = v1::Reading { shares: vec![0.25, 0.75], ..reading("activity", 0.0) };
        assert_eq!(whole, columns_of(&[sent], 7).expect("valid"));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |readings: &[v1::Reading]| columns_of(readings, 7).expect_err("wrong").field;
        assert_eq!(field(&[]), "readings");
        let placed = |position: &[f64]| v1::Reading { position: position.to_vec(), ..reading("anna", 0.0) };
        assert_eq!(field(&[placed(&[1.0])]), "readings[0].position");
        assert_eq!(field(&[placed(&[1.0, 2.0]), reading("anna", 1.0)]), "readings[1].kind");
        let label = v1::Reading { label: "eat".to_owned(), ..reading("activity", 0.0) };
        assert_eq!(field(&[v1::Reading { shares: vec![1.0, 0.0], ..label.clone() }]), "readings[0].label");
        assert_eq!(field(&[v1::Reading { kind: v1::StateKind::Count.into(), ..label }]), "readings[0].kind");
        let bare = v1::Reading { kind: v1::StateKind::Categorical.into(), ..reading("activity", 1.0) };
        assert_eq!(field(&[bare]), "readings[0].label");
        assert_eq!(field(&[v1::Reading { time: Some(timestamp(-1)), ..reading("door", 1.0) }]), "readings[0].time");
    }
}
