//! Confidence and model of a request for anomalies, and what a watch is of.
//!
//! Invariant: a region to watch has at least one cell; whether the map has what is named is not checked.

use tidemap_grid::index::CellBox;
use tidemap_map::{
    anomaly::{CannotJudge, Confidence, can_judge, can_watch},
    name::StateName,
};
use tidemap_model::selector::ModelSelector;

use super::{InvalidField, grid::cell_box_from_wire, query::selector_from_wire, site::location_name_from_wire};
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

/// The question of a request to watch. Without names, location and region, all states are watched.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchQuestion {
    /// Names of states and cells.
    pub states: Vec<String>,
    /// Name of a location, whose states and cells are watched.
    pub location: Option<StateName>,
    /// A region whose cells are watched.
    pub region: Option<CellBox>,
    /// How certain it has to be that an observation is unexpected.
    pub confidence: Confidence,
    /// The model that judges.
    pub selector: ModelSelector,
}

/// The question of a request to watch.
///
/// # Errors
/// The invalid field.
pub fn watch_from_wire(request: v1::WatchAnomaliesRequest) -> Result<WatchQuestion, InvalidField> {
    let v1::WatchAnomaliesRequest { states, confidence, model, region, location, .. } = request;
    let confidence = confidence_from_wire("confidence", confidence)?;
    let selector = watching_judge_from_wire("model", model)?;
    let location = (!location.is_empty()).then(|| location_name_from_wire("location", &location)).transpose()?;
    let region = region.as_ref().map(cell_box_from_wire);
    if region.is_some_and(|region| region.count() == 0) {
        let text = "the region holds no cells: each maximum is above its minimum";
        return Err(InvalidField::new("region", text));
    }
    Ok(WatchQuestion { states, location, region, confidence, selector })
}

fn cannot_judge(field: &str, error: CannotJudge) -> InvalidField {
    let name = match error {
        CannotJudge::Persistence => "persistence",
        CannotJudge::Memory => "memory",
        CannotJudge::Newest(_) | CannotJudge::NeedsTraining(_) => "kind",
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

    #[test]
    fn a_watch_of_nothing_in_particular_is_of_all_states() {
        let question = watch_from_wire(v1::WatchAnomaliesRequest::default()).expect("right");
        assert!(question.states.is_empty() && question.location.is_none() && question.region.is_none());
    }

    #[test]
    fn what_is_wrong_of_a_watch_is_named() {
        let field = |request| watch_from_wire(request).expect_err("wrong").field;
        let region = Some(v1::CellBox::default());
        assert_eq!(field(v1::WatchAnomaliesRequest { region, ..Default::default() }), "region");
        let location = "a/b".to_owned();
        assert_eq!(field(v1::WatchAnomaliesRequest { location, ..Default::default() }), "location");
        assert_eq!(field(v1::WatchAnomaliesRequest { confidence: Some(0.2), ..Default::default() }), "confidence");
    }
}
