//! The models from which the updates of a map select.
//!
//! Invariant: a refusal names the valid models; the spectral model is always included.

use tidemap_grid::spec::Retention;
use tidemap_model::{EnabledModels, FitKind};

use super::InvalidField;
use crate::v1::ModelKind;

/// The valid models, in words.
const CANDIDATES: &str = "spectral, histogram, calibrated, poisson, pergam, hypertime-em and hypertime-km";

/// The kind on the wire of a model that is trained on observations.
fn wire(kind: FitKind) -> ModelKind {
    match kind {
        FitKind::Calibrated => ModelKind::Calibrated,
        FitKind::Pergam => ModelKind::Pergam,
        FitKind::HypertimeEm => ModelKind::HypertimeEm,
        FitKind::Poisson => ModelKind::Poisson,
        FitKind::HypertimeKm => ModelKind::HypertimeKm,
    }
}

/// The models of a request; if it names none, the default ones that the map can have.
///
/// # Errors
/// A model from which updates do not select, or one that is trained on observations which the map does not keep.
pub fn enabled_from_wire(field: &str, wanted: &[i32], retention: Retention) -> Result<EnabledModels, InvalidField> {
    let keeps = retention != Retention::None;
    if wanted.is_empty() {
        let usual = EnabledModels::default();
        return Ok(if keeps { usual } else { usual.without_fits() });
    }
    let mut models = EnabledModels::SPECTRAL;
    for &number in wanted {
        let kind = ModelKind::try_from(number).ok();
        let fit = FitKind::ALL.into_iter().find(|&fit| Some(wire(fit)) == kind);
        match (kind, fit) {
            (Some(ModelKind::Spectral), _) => {}
            (Some(ModelKind::Histogram), _) => models.histograms = true,
            (_, Some(fit)) if keeps => models = models.with_fit(fit),
            (_, Some(fit)) => {
                let text = format!(
                    "{} is fitted to stored observations, of which this map keeps none: keep them, as with --retention \
                     90d, or leave it out",
                    fit.name()
                );
                return Err(InvalidField::new(field, text));
            }
            (kind, None) => {
                let name = kind.map_or_else(|| number.to_string(), |kind| kind.as_str_name().to_owned());
                return Err(InvalidField::new(field, format!("{name} is not chosen among: there are {CANDIDATES}")));
            }
        }
    }
    Ok(models)
}

/// Models for the wire.
#[must_use]
pub fn enabled_to_wire(models: EnabledModels) -> Vec<i32> {
    let histogram = models.histograms.then_some(ModelKind::Histogram);
    let fits = models.fits().map(wire);
    [ModelKind::Spectral].into_iter().chain(histogram).chain(fits).map(i32::from).collect()
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
        assert_eq!(all.len(), 7);
        assert_eq!(enabled_from_wire("models", &all, Retention::Forever), Ok(EnabledModels::ALL));
        let one = enabled(&[ModelKind::HypertimeKm], Retention::Forever).expect("known");
        assert_eq!(one, EnabledModels::SPECTRAL.with_fit(FitKind::HypertimeKm));
        assert_eq!(enabled_to_wire(one), [i32::from(ModelKind::Spectral), i32::from(ModelKind::HypertimeKm)]);
        assert_eq!(enabled(&[ModelKind::Spectral], Retention::None), Ok(EnabledModels::SPECTRAL));
    }

    #[test]
    fn a_map_that_names_none_has_the_usual_ones() {
        assert_eq!(enabled(&[], Retention::Forever), Ok(EnabledModels::default()));
        let kept_for_none = EnabledModels::SPECTRAL.with_histograms(true);
        assert_eq!(enabled(&[], Retention::None), Ok(kept_for_none));
    }

    #[test]
    fn what_cannot_be_is_refused_with_what_there_is() {
        for kind in [ModelKind::Unspecified, ModelKind::Auto, ModelKind::Uniform] {
            let error = enabled(&[ModelKind::Histogram, kind], Retention::Forever).expect_err("no candidate");
            assert!(error.contains(kind.as_str_name()) && error.contains(CANDIDATES), "{error}");
        }
        let error = enabled_from_wire("models", &[99], Retention::Forever).expect_err("unknown").to_string();
        assert!(error.contains("99") && error.contains(CANDIDATES), "{error}");
        let error = enabled(&[ModelKind::Pergam], Retention::None).expect_err("nothing kept");
        assert!(error.contains("pergam") && error.contains("--retention"), "{error}");
    }
}
