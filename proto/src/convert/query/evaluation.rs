//! Comparisons of predictions with observations: the messages of a request, and the reply.
//!
//! Invariant: the first message is the header, and every later one has observations, of times from 1970 on and of names
//! of the stream's table.

use tidemap_model::{
    Evaluation, ORDER_MAX,
    selector::{ModelKind, ModelSelector},
};

use super::{order_from_wire, selector_from_wire, selector_to_wire};
use crate::{
    convert::{
        InvalidField,
        columns::{DecodedColumns, PackedColumns},
    },
    v1::{self, evaluate_states_request::Message},
};

/// The models to compare, from the header of a request.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluationQuestion {
    /// Different models; at least one.
    pub models: Vec<ModelSelector>,
    /// The highest order to compare, 0 to 15.
    pub max_order: usize,
}

/// The header in the first message of a request.
///
/// # Errors
/// There is none.
pub fn header_of(first: Option<v1::EvaluateStatesRequest>) -> Result<v1::EvaluateHeader, InvalidField> {
    match first.and_then(|request| request.message) {
        Some(Message::Header(header)) => Ok(header),
        _ => Err(InvalidField::new("header", "the first message of the stream must be the header")),
    }
}

/// Reads the models to compare from a header.
///
/// # Errors
/// The invalid field.
pub fn evaluation_from_wire(header: v1::EvaluateHeader) -> Result<EvaluationQuestion, InvalidField> {
    let max_order = header.max_order.map(|order| order_from_wire("header.max_order", order)).transpose()?;
    let mut models = Vec::with_capacity(header.models.len());
    for (i, model) in header.models.into_iter().enumerate() {
        let model = selector_from_wire(&format!("header.models[{i}]"), Some(model))?;
        if !models.contains(&model) {
            models.push(model);
        }
    }
    if models.is_empty() {
        models.push(ModelSelector { kind: ModelKind::Spectral, ..ModelSelector::default() });
    }
    Ok(EvaluationQuestion { models, max_order: max_order.unwrap_or(ORDER_MAX) })
}

/// The observations of a later message, still packed.
///
/// # Errors
/// There are none, or some are positions.
pub fn evaluated_from_wire(request: v1::EvaluateStatesRequest) -> Result<PackedColumns, InvalidField> {
    let Some(Message::Observations(columns)) = request.message else {
        return Err(InvalidField::new("observations", "every message after the first must have them"));
    };
    let columns = PackedColumns::from(columns);
    if columns.has_coordinates() {
        let text = "positions cannot be compared: compare each axis, NAME/x and so on";
        return Err(InvalidField::new("observations.coordinates", text));
    }
    Ok(columns)
}

/// Unpacks the observations of a message whose stream's table has `names` names.
///
/// # Errors
/// Columns that do not fit each other, a name beyond the table, or a time before 1970.
pub fn unpack_evaluated(columns: PackedColumns, names: usize) -> Result<DecodedColumns, InvalidField> {
    let columns = columns.unpack()?;
    if let Some(index) = columns.state_indices.iter().find(|&&index| index as usize >= names) {
        let text = format!("{index} is beyond the stream's table of {names} names");
        return Err(InvalidField::new("observations.state_indices", text));
    }
    match columns.times_nanos.iter().find(|&&time| time < 0) {
        Some(time) => Err(InvalidField::new("observations.times", format!("{time} ns is before 1970"))),
        None => Ok(columns),
    }
}

/// The errors of a model at predicting the observations of a state.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluatedModel<'a> {
    /// Name of the state.
    pub state: String,
    /// The model, with its order.
    pub model: ModelSelector,
    /// The errors.
    pub errors: &'a Evaluation,
    /// Whether the state is a probability: only then the reply has a rate of errors.
    pub is_probability: bool,
    /// Whether labels were observed: only then the reply has a loss.
    pub has_labels: bool,
}

/// The errors of a model for the wire.
#[must_use]
pub fn evaluated_model_to_wire(evaluated: EvaluatedModel<'_>) -> v1::Evaluation {
    let EvaluatedModel { state, model, errors, is_probability, has_labels } = evaluated;
    v1::Evaluation {
        state,
        model: Some(selector_to_wire(model)),
        observations: errors.observations,
        mean_squared_error: errors.mse(),
        error_rate: is_probability.then(|| errors.error_rate()),
        log_loss_bits: has_labels.then(|| errors.log_loss_bits()),
    }
}

/// A model that these states do not have, and the reason, for the wire.
#[must_use]
pub fn unavailable_model_to_wire(model: ModelSelector, reason: &str, states: Vec<String>) -> v1::UnavailableModel {
    v1::UnavailableModel { model: Some(selector_to_wire(model)), reason: reason.to_owned(), states }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::columns::encode;

    fn message(columns: v1::ObservationColumns) -> v1::EvaluateStatesRequest {
        v1::EvaluateStatesRequest { message: Some(Message::Observations(columns)) }
    }

    #[test]
    fn the_header_comes_first_and_observations_after_it() {
        let header = || v1::EvaluateStatesRequest { message: Some(Message::Header(v1::EvaluateHeader::default())) };
        assert!(header_of(Some(header())).is_ok());
        assert_eq!(header_of(None).expect_err("nothing").field, "header");
        let columns = encode(&[1], &[0], &[0.5], Vec::new());
        assert_eq!(header_of(Some(message(columns.clone()))).expect_err("too early").field, "header");
        assert_eq!(evaluated_from_wire(header()).expect_err("too late").field, "observations");
        let placed = v1::ObservationColumns { coordinates: vec![1.0, 2.0], ..columns };
        assert_eq!(evaluated_from_wire(message(placed)).expect_err("a position").field, "observations.coordinates");
    }

    #[test]
    fn every_model_is_compared_once_and_the_spectral_one_if_none_is_named() {
        let models = |models: Vec<v1::ModelSelector>| {
            let header = v1::EvaluateHeader { models, ..v1::EvaluateHeader::default() };
            evaluation_from_wire(header).expect("right").models.into_iter().map(|model| model.kind).collect::<Vec<_>>()
        };
        let mean = v1::ModelSelector { kind: v1::ModelKind::Mean.into(), ..v1::ModelSelector::default() };
        assert_eq!(models(vec![mean, mean]), [ModelKind::Mean]);
        assert_eq!(models(Vec::new()), [ModelKind::Spectral]);
        let wrong = v1::EvaluateHeader { max_order: Some(16), ..v1::EvaluateHeader::default() };
        assert_eq!(evaluation_from_wire(wrong).expect_err("too high").field, "header.max_order");
    }

    #[test]
    fn observations_of_unknown_names_or_times_are_refused() {
        let unpack = |times: &[i64], indices: &[u32]| {
            let packed = evaluated_from_wire(message(encode(times, indices, &vec![0.5; times.len()], Vec::new())));
            unpack_evaluated(packed.expect("right"), 2).map_err(|error| error.field)
        };
        assert!(unpack(&[1, 2], &[0, 1]).is_ok());
        assert_eq!(unpack(&[1, 2], &[0, 2]).err().as_deref(), Some("observations.state_indices"));
        assert_eq!(unpack(&[1, -2], &[0, 1]).err().as_deref(), Some("observations.times"));
    }

    #[test]
    fn only_probabilities_have_a_rate_of_errors_and_only_labels_a_loss() {
        let errors = Evaluation { observations: 4, squared_error: 2.0, wrong: 1, log_loss_bits: 6.0 };
        let row = |is_probability, has_labels| {
            let (state, model) = ("door".to_owned(), ModelSelector::default());
            let evaluated = EvaluatedModel { state, model, errors: &errors, is_probability, has_labels };
            let wire = evaluated_model_to_wire(evaluated);
            assert_eq!((wire.state.as_str(), wire.observations, wire.mean_squared_error), ("door", 4, 0.5));
            (wire.error_rate, wire.log_loss_bits)
        };
        assert_eq!(row(false, false), (None, None));
        assert_eq!(row(true, false), (Some(0.25), None));
        assert_eq!(row(false, true), (None, Some(1.5)));
    }
}
