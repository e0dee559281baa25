//! Confidence and model of a request for anomalies.

use tidemap_map::anomaly::{CannotJudge, Confidence, can_judge, can_watch};
use tidemap_model::selector::ModelSelector;

use super::{InvalidField, query::selector_from_wire};
use crate::v1;

/// The confidence, 0.99 by default.
///
/// # Errors
/// The confidence is not above 0.5 and at most 1.
pub fn confidence_from_wire(field: &str, wire: Option<f64>) -> Result<Confidence, InvalidField> {
    let confidence = wire.map(Confidence::new).transpose().map_err(|error| InvalidField::new(field, error))?;
    Ok(confidence.unwrap_or_default())
}

/// The model that judges past observations.
///
/// # Errors
/// The errors of [`selector_from_wire`], or the model predicts from the newest value.
pub fn judge_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let selector = selector_from_wire(field, wire)?;
    can_judge(selector).map_err(|error| cannot_judge(field, error))?;
    Ok(selector)
}

/// The model that judges observations as they arrive.
///
/// # Errors
/// The errors of [`selector_from_wire`], or the model predicts from the newest value or must be trained first.
pub fn watching_judge_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let selector = selector_from_wire(field, wire)?;
    can_watch(selector).map_err(|error| cannot_judge(field, error))?;
    Ok(selector)
}

fn cannot_judge(field: &str, error: CannotJudge) -> InvalidField {
    let name = match error {
        CannotJudge::Persistence => "persistence",
        CannotJudge::Memory => "memory",
        CannotJudge::Newest(_) | CannotJudge::NeedsFit(_) => "kind",
    };
    InvalidField::new(format!("{field}.{name}"), error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_confidence_is_that_of_the_paper_unless_told_otherwise() {
        assert_eq!(confidence_from_wire("confidence", None).map(Confidence::get), Ok(0.99));
        assert_eq!(confidence_from_wire("confidence", Some(0.6)).map(Confidence::get), Ok(0.6));
        for wrong in [0.0, 0.5, 1.5, f64::NAN] {
            assert_eq!(
                confidence_from_wire("confidence", Some(wrong)).map_err(|error| error.field),
                Err("confidence".to_owned())
            );
        }
    }

    #[test]
    fn a_model_that_cannot_judge_is_refused_by_the_field_that_makes_it_so() {
        let wire = |kind: v1::ModelKind, persistence| {
            Some(v1::ModelSelector { kind: kind.into(), persistence, ..v1::ModelSelector::default() })
        };
        let field = |error: InvalidField| error.field;
        let judge = |kind, persistence| judge_from_wire("model", wire(kind, persistence)).map_err(field);
        let watching = |kind, persistence| watching_judge_from_wire("model", wire(kind, persistence)).map_err(field);
        assert_eq!(judge_from_wire("model", None), Ok(ModelSelector::default()));
        assert_eq!(judge(v1::ModelKind::Latest, false), Err("model.kind".to_owned()));
        assert_eq!(judge(v1::ModelKind::Auto, true), Err("model.persistence".to_owned()));
        assert!(judge(v1::ModelKind::Calibrated, false).is_ok());
        assert_eq!(watching(v1::ModelKind::Calibrated, false), Err("model.kind".to_owned()));
        assert_eq!(watching(v1::ModelKind::Mean, true), Err("model.persistence".to_owned()));
        assert!(watching(v1::ModelKind::Mean, false).is_ok());
    }
}
