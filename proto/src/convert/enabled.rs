//! The models from which the updates of a map select.
//!
//! Invariant: a refusal names the valid models; the spectral model is always included.

use tidemap_grid::spec::Retention;
use tidemap_model::EnabledModels;

use super::{
    InvalidField,
    model_kind::{model_kind_from_wire, model_kind_to_wire},
};
use crate::v1::ModelKind;

/// The models of a request; if it names none, the default ones that the map can have.
///
/// # Errors
/// A model from which updates do not select, or one that is trained on observations which the map does not keep.
pub fn enabled_from_wire(field: &str, wanted: &[i32], retention: Retention) -> Result<EnabledModels, InvalidField> {
    let keeps = retention != Retention::None;
    if wanted.is_empty() {
        let usual = EnabledModels::default();
        return Ok(if keeps { usual } else { usual.without_trained() });
    }
    let mut models = EnabledModels::SPECTRAL;
    for &number in wanted {
        let wire = ModelKind::try_from(number).ok();
        let kind = wire.and_then(model_kind_from_wire);
        let with_kind = kind.and_then(|kind| Some((kind, models.with_named(kind.name())?)));
        let Some((kind, with_kind)) = with_kind else {
            let name = wire.map_or_else(|| number.to_string(), |kind| kind.as_str_name().to_owned());
            let known = EnabledModels::all_names();
            return Err(InvalidField::new(field, format!("{name} is not chosen among: there are {known}")));
        };
        if !keeps && with_kind.without_trained() != with_kind {
            let text = format!(
                "{} is trained on stored observations, and this map keeps none: keep them, with a retention such \
                 as 90d, or leave it out",
                kind.name()
            );
            return Err(InvalidField::new(field, text));
        }
        models = with_kind;
    }
    Ok(models)
}

/// Models for the wire.
#[must_use]
pub fn enabled_to_wire(models: EnabledModels) -> Vec<i32> {
    models.kinds().map(|kind| model_kind_to_wire(kind).into()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enabled(kinds: &[ModelKind], retention: Retention) -> Result<EnabledModels, String> {
        let wanted: Vec<i32> = kinds.iter().map(|&kind| kind.into()).collect();
        enabled_from_wire("models", &wanted, retention).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_named_is_enabled_and_the_spectral_model_always() {
        let all = enabled_to_wire(EnabledModels::ALL);
        assert_eq!(all.len(), 8);
        assert_eq!(enabled_from_wire("models", &all, Retention::Forever), Ok(EnabledModels::ALL));
        let one = enabled(&[ModelKind::HypertimeKm], Retention::Forever).expect("known");
        assert_eq!(one, EnabledModels::SPECTRAL.with(tidemap_model::catalogue::ModelKind::HYPERTIME_KM));
        assert_eq!(enabled_to_wire(one), [i32::from(ModelKind::Spectral), i32::from(ModelKind::HypertimeKm)]);
        assert_eq!(enabled(&[ModelKind::Spectral], Retention::None), Ok(EnabledModels::SPECTRAL));
    }

    #[test]
    fn a_map_that_names_none_has_the_usual_ones() {
        assert_eq!(enabled(&[], Retention::Forever), Ok(EnabledModels::default()));
        let kept_for_none =
            EnabledModels::SPECTRAL.with_histograms(true).with(tidemap_model::catalogue::ModelKind::Ensemble);
        assert_eq!(enabled(&[], Retention::None), Ok(kept_for_none));
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_there_is() {
        for kind in [ModelKind::Unspecified, ModelKind::Auto, ModelKind::Uniform] {
            let error = enabled(&[ModelKind::Histogram, kind], Retention::Forever).expect_err("no candidate");
            assert!(error.contains(kind.as_str_name()) && error.contains(&EnabledModels::all_names()), "{error}");
        }
        let error = enabled_from_wire("models", &[99], Retention::Forever).expect_err("unknown").to_string();
        assert!(error.contains("99") && error.contains(&EnabledModels::all_names()), "{error}");
        let error = enabled(&[ModelKind::Pergam], Retention::None).expect_err("nothing kept");
        assert!(error.contains("pergam") && error.contains("retention"), "{error}");
    }
}
