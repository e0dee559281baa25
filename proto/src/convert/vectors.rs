//! Vectors: kinds and dimensions of the names of a message, and coordinates as positions.
//!
//! Invariant: decoding checks that the number of coordinates matches the names; whether an observation may have them is
//! checked for each one later.

use tidemap_map::{
    event::{Dimensions, Position, RowKind, StateKind, StateSensor, StateShape, StatedReporting},
    name::StateName,
};

use tidemap_model::LABELS;

use super::{
    InvalidField,
    labels::labels_from_wire,
    map::{kind_from_wire, kind_to_wire},
    reporting::reporting_from_wire,
    state_sensor::state_sensor_from_wire,
};
use crate::v1;

/// The shape that a request declares for a name, from these fields; `None`: not declared.
///
/// # Errors
/// An unknown kind, a vector that has neither 2 nor 3 coordinates, too many labels, or coordinates of a state that has
/// none.
pub fn shape_from_wire(
    (kind_field, kind): (&str, i32),
    (dimensions_field, dimensions): (&str, u32),
) -> Result<Option<StateShape>, InvalidField> {
    let shape = match v1::StateKind::try_from(kind) {
        Ok(v1::StateKind::Angle) => Some(StateShape::Angle),
        Ok(v1::StateKind::Categorical) => {
            let labels = u8::try_from(dimensions).ok();
            let is_sound = |labels: &u8| *labels == 0 || LABELS.contains(&usize::from(*labels));
            let text =
                || format!("{dimensions} labels: a categorical state has {} to {}", LABELS.start(), LABELS.end());
            return labels
                .filter(is_sound)
                .map(|labels| Some(StateShape::Categorical(labels)))
                .ok_or_else(|| InvalidField::new(dimensions_field, text()));
        }
        Ok(v1::StateKind::Vector) => {
            let count = usize::try_from(dimensions).ok().and_then(Dimensions::of);
            let text = || format!("{dimensions} coordinates: a vector has 2 or 3");
            return count
                .map(|count| Some(StateShape::Vector(count)))
                .ok_or_else(|| InvalidField::new(dimensions_field, text()));
        }
        Ok(kind) => kind_from_wire(kind).map(StateShape::Scalar),
        Err(_) => return Err(InvalidField::new(kind_field, format!("{kind} is not known"))),
    };
    if dimensions != 0 {
        let text = format!("{dimensions} coordinates, but the state is not a vector: it must be 0");
        return Err(InvalidField::new(dimensions_field, text));
    }
    Ok(shape)
}

/// A state to add.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeclaredState {
    /// Name of the state.
    pub name: StateName,
    /// Shape of the observations of the state.
    pub shape: StateShape,
    /// The states of its labels; only of a categorical state.
    pub labels: Vec<StateName>,
    /// The sensor that reads it; `None`: not stated.
    pub sensor: Option<StateSensor>,
    /// How the state is reported; `None`: not stated.
    pub reporting: Option<StatedReporting>,
}

/// A state to add.
///
/// # Errors
/// The invalid field.
pub fn declared_state_from_wire(request: &v1::AddStateRequest) -> Result<DeclaredState, InvalidField> {
    let v1::AddStateRequest { state, kind, dimensions, sensor, reporting, labels, .. } = request;
    let invalid = |error| InvalidField::new("state", error);
    let name = StateName::observed(state).map_err(invalid)?;
    let has_events = reporting.as_ref().is_some_and(|reporting| reporting.kind == i32::from(v1::RowKind::Events));
    let shape = shape_from_wire(("kind", *kind), ("dimensions", *dimensions))?;
    let mut shape = shape.unwrap_or_else(|| if has_events { StateKind::Count.into() } else { StateShape::default() });
    if let StateShape::Vector(_) | StateShape::Angle | StateShape::Categorical(_) = shape {
        name.check_vector().map_err(invalid)?;
    }
    let labels = match shape {
        StateShape::Categorical(_) => labels_from_wire(&name, labels)?,
        _ if labels.is_empty() => Vec::new(),
        _ => {
            let text = format!("{} has no labels: only a categorical state has", shape.with_article());
            return Err(InvalidField::new("labels", text));
        }
    };
    if let StateShape::Categorical(count) = &mut shape {
        // There are at most 64 labels.
        *count = labels.len() as u8;
    }
    let sensor = sensor.as_ref().map(state_sensor_from_wire).transpose()?;
    if sensor.is_some() && !shape.may_have_sensor() {
        return Err(InvalidField::new("sensor", format!("{} has none: only a probability has", shape.with_article())));
    }
    let reporting = reporting.as_ref().map(|wire| reporting_from_wire("reporting", wire)).transpose()?;
    if let Some(reporting) = reporting.filter(|reporting| !shape.may_report(reporting.for_new())) {
        return Err(InvalidField::new("reporting", cannot_report(shape, reporting.kind())));
    }
    Ok(DeclaredState { name, shape, labels, sensor, reporting })
}

/// Why a state of a shape is not reported like that.
#[must_use]
pub fn cannot_report(shape: StateShape, kind: RowKind) -> String {
    let rule = match kind {
        RowKind::Events => "only a count has events",
        RowKind::Changes | RowKind::Samples => "positions, angles and labels have samples only",
    };
    format!("{} is not reported by {}: {rule}", shape.with_article(), kind.name())
}

/// A shape for the wire: its kind, and the number of its coordinates or labels, 0 for values.
#[must_use]
pub fn shape_to_wire(shape: StateShape) -> (v1::StateKind, u32) {
    match shape {
        StateShape::Scalar(kind) => (kind_to_wire(kind), 0),
        StateShape::Angle => (v1::StateKind::Angle, 0),
        StateShape::Categorical(labels) => (v1::StateKind::Categorical, u32::from(labels)),
        StateShape::Vector(dimensions) => {
            (v1::StateKind::Vector, u32::try_from(dimensions.count()).unwrap_or(u32::MAX))
        }
    }
}

/// The shapes that a message declares for its new names, one each; `None`: not declared.
///
/// # Errors
/// The errors of [`shape_from_wire`], or another number of entries than names.
pub fn new_shapes(columns: &v1::ObservationColumns) -> Result<Vec<Option<StateShape>>, InvalidField> {
    const KINDS: &str = "observations.new_kinds";
    const DIMENSIONS: &str = "observations.new_dimensions";
    let names = columns.new_states.len();
    for (field, entries) in [(KINDS, columns.new_kinds.len()), (DIMENSIONS, columns.new_dimensions.len())] {
        if entries != 0 && entries != names {
            let text = format!("{entries} entries for {names} new_states: one each, or none");
            return Err(InvalidField::new(field, text));
        }
    }
    let kind = |i: usize| columns.new_kinds.get(i).copied().unwrap_or_default();
    let dimensions = |i: usize| columns.new_dimensions.get(i).copied().unwrap_or_default();
    (0..names).map(|i| shape_from_wire((KINDS, kind(i)), (DIMENSIONS, dimensions(i)))).collect()
}

/// The positions of a message, each with the index of its observation; `dimensions` returns those of a name by its
/// index in the stream's table, `None` for a state that is not a vector.
///
/// # Errors
/// The number of coordinates does not match the observations.
pub fn positions(
    state_indices: &[u32],
    coordinates: &[f64],
    dimensions: impl Fn(u32) -> Option<Dimensions>,
) -> Result<Vec<(u32, Position)>, InvalidField> {
    let vectors = || (0..).zip(state_indices).filter_map(|(i, &index)| Some((i, dimensions(index)?)));
    let wanted: usize = vectors().map(|(_, dimensions)| dimensions.count()).sum();
    if wanted != coordinates.len() {
        let text = format!("{} entries: the observations of vectors in this message have {wanted}", coordinates.len());
        return Err(InvalidField::new("observations.coordinates", text));
    }
    let mut rest = coordinates;
    let position = |(i, dimensions): (u32, Dimensions)| {
        let (own, others) = rest.split_at_checked(dimensions.count())?;
        rest = others;
        Some((i, Position::of(own)?))
    };
    Ok(vectors().map_while(position).collect())
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::{convert::columns, v1::ObservationColumns};

    fn message() -> ObservationColumns {
        let names = ["door", "anna", "drone"].map(str::to_owned).to_vec();
        ObservationColumns {
            new_kinds: vec![0, v1::StateKind::Vector.into(), v1::StateKind::Vector.into()],
            new_dimensions: vec![0, 2, 3],
            coordinates: vec![1.5, -2.0, 0.25, 1e12, f64::NAN, 7.0, 8.0],
            ..columns::encode(&[1, 2, 3, 4], &[1, 0, 2, 1], &[0.0, 1.0, 0.0, 0.0], names)
        }
    }

    #[test]
    fn positions_survive_the_wire() {
        let bytes = message().encode_to_vec();
        let read = ObservationColumns::decode(bytes.as_slice()).expect("a message");
        let shapes = new_shapes(&read).expect("well formed");
        assert_eq!(
            shapes,
            [None, Some(StateShape::Vector(Dimensions::Two)), Some(StateShape::Vector(Dimensions::Three))]
        );
        let coordinates = read.coordinates.clone();
        let decoded = columns::decode(read).expect("well formed");
        let dimensions = |index: u32| match shapes.get(index as usize) {
            Some(Some(StateShape::Vector(dimensions))) => Some(*dimensions),
            _ => None,
        };
        let found = positions(&decoded.state_indices, &coordinates, dimensions).expect("as many as requested");
        let bits = |numbers: &[f64]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
        let found: Vec<_> = found.iter().map(|(i, position)| (*i, bits(position.coordinates()))).collect();
        assert_eq!(found, [(0, bits(&[1.5, -2.0])), (2, bits(&[0.25, 1e12, f64::NAN])), (3, bits(&[7.0, 8.0]))]);
        for wrong in [&coordinates[1..], &[&coordinates[..], &[0.0]].concat(), &[]] {
            let error = positions(&decoded.state_indices, wrong, dimensions).expect_err("not as many");
            assert_eq!(error.field, "observations.coordinates");
        }
        assert_eq!(positions(&[0, 5], &[], dimensions), Ok(Vec::new()));
    }

    #[test]
    fn names_that_cannot_be_are_errors() {
        let wrong = |change: fn(&mut ObservationColumns)| {
            let mut message = message();
            change(&mut message);
            new_shapes(&message).expect_err("malformed").field
        };
        assert_eq!(wrong(|m| m.new_dimensions.clear()), "observations.new_dimensions");
        assert_eq!(wrong(|m| m.new_dimensions = vec![0, 1, 3]), "observations.new_dimensions");
        assert_eq!(wrong(|m| m.new_dimensions = vec![0, 4, 3]), "observations.new_dimensions");
        assert_eq!(wrong(|m| m.new_dimensions = vec![2, 2, 3]), "observations.new_dimensions");
        assert_eq!(wrong(|m| m.new_dimensions = vec![2]), "observations.new_dimensions");
        assert_eq!(wrong(|m| m.new_kinds = vec![0, 4]), "observations.new_kinds");
        assert_eq!(wrong(|m| m.new_kinds = vec![0, 4, 99]), "observations.new_kinds");
        let nothing = ObservationColumns { new_states: vec!["door".to_owned()], ..ObservationColumns::default() };
        assert_eq!(new_shapes(&nothing), Ok(vec![None]));
    }
}
