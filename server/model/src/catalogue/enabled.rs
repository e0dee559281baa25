//! The models that the nightly update of a map may choose among.
//!
//! Invariant: the spectral model is always one of them. Models are enabled by name; the update tries each with the
//! parameters of the catalogue.

use super::{HISTOGRAMS, ModelKind, TRAINED_AT_NIGHT, TrainingCost, name::listed};

/// The models that the update of a state chooses among. The spectral model always is one of them; its order 0 is the
/// mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EnabledModels(u32);

/// The bit of histograms; the bits of [`TRAINED_AT_NIGHT`] follow. The bits are stored.
const HISTOGRAM_BIT: u32 = 1;

/// The bit of the ensemble; the bits below it are free for further models.
const ENSEMBLE_BIT: u32 = 1 << 30;

/// The bit of models of this name; 0 for the spectral model; `None` if updates do not choose such models.
fn bit(name: &str) -> Option<u32> {
    let trained = || TRAINED_AT_NIGHT.iter().position(|kind| kind.name() == name);
    match name {
        _ if name == ModelKind::Spectral.name() => Some(0),
        _ if name == ModelKind::Ensemble.name() => Some(ENSEMBLE_BIT),
        _ if HISTOGRAMS.iter().any(|kind| kind.name() == name) => Some(HISTOGRAM_BIT),
        _ => trained().map(|place| HISTOGRAM_BIT << (place + 1)),
    }
}

impl Default for EnabledModels {
    /// Histograms, the models whose training is cheap, and the ensemble.
    fn default() -> EnabledModels {
        let cheap = TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.is_cheap());
        cheap.fold(EnabledModels(HISTOGRAM_BIT | ENSEMBLE_BIT), EnabledModels::with)
    }
}

impl EnabledModels {
    /// The spectral model alone.
    pub const SPECTRAL: EnabledModels = EnabledModels(0);

    /// All models.
    pub const ALL: EnabledModels = EnabledModels(ENSEMBLE_BIT | ((HISTOGRAM_BIT << (TRAINED_AT_NIGHT.len() + 1)) - 1));

    /// These models, and those of the kind, whatever its parameters; unchanged if updates do not choose the kind.
    #[must_use]
    pub fn with(self, kind: ModelKind) -> EnabledModels {
        EnabledModels(self.0 | bit(kind.name()).unwrap_or(0))
    }

    /// These models, with or without histograms.
    #[must_use]
    pub fn with_histograms(self, histograms: bool) -> EnabledModels {
        EnabledModels(if histograms { self.0 | HISTOGRAM_BIT } else { self.0 & !HISTOGRAM_BIT })
    }

    /// These models, and the one with this name (see [`EnabledModels::names`]); for `all`, every model; `None` for any
    /// other name.
    #[must_use]
    pub fn with_named(self, name: &str) -> Option<EnabledModels> {
        if name == "all" { Some(EnabledModels::ALL) } else { bit(name).map(|bit| EnabledModels(self.0 | bit)) }
    }

    /// The names of the models, as on the command line.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.kinds().map(ModelKind::name)
    }

    /// The models, each kind once, with default parameters: the spectral one, histograms, those that are trained, and
    /// the ensemble.
    pub fn kinds(self) -> impl Iterator<Item = ModelKind> {
        let histogram = HISTOGRAMS.into_iter().take(1).filter(move |_| self.has_histograms());
        let ensemble = Some(ModelKind::Ensemble).filter(move |_| self.has_ensemble());
        std::iter::once(ModelKind::Spectral).chain(histogram).chain(self.trained()).chain(ensemble)
    }

    /// These models without those that are trained on readings.
    #[must_use]
    pub fn without_trained(self) -> EnabledModels {
        EnabledModels(self.0 & (ENSEMBLE_BIT | HISTOGRAM_BIT))
    }

    /// These models without the ensemble.
    #[must_use]
    pub fn without_ensemble(self) -> EnabledModels {
        EnabledModels(self.0 & !ENSEMBLE_BIT)
    }

    /// Whether an ensemble of all models predicts.
    pub fn has_ensemble(self) -> bool {
        self.0 & ENSEMBLE_BIT != 0
    }

    /// Whether [`HISTOGRAMS`] are tried.
    pub fn has_histograms(self) -> bool {
        self.0 & HISTOGRAM_BIT != 0
    }

    /// Whether models of the kind are enabled, whatever its parameters.
    pub fn has(self, kind: ModelKind) -> bool {
        bit(kind.name()).is_some_and(|bit| self.0 & bit == bit)
    }

    /// The models of [`TRAINED_AT_NIGHT`] that are enabled.
    pub fn trained(self) -> impl Iterator<Item = ModelKind> {
        TRAINED_AT_NIGHT.into_iter().filter(move |&kind| self.has(kind))
    }

    /// The names of all models that can be enabled, in a sentence: cheap ones first.
    pub fn all_names() -> String {
        let mut kinds: Vec<ModelKind> = EnabledModels::ALL.kinds().collect();
        kinds.sort_by_key(|kind| (*kind == ModelKind::Ensemble, kind.cost() > Some(TrainingCost::Low)));
        listed(kinds.into_iter().map(ModelKind::name), "and")
    }

    /// The number to store: the sum of 1 for histograms, 2, 4, 8, … for [`TRAINED_AT_NIGHT`], 2^30 for the ensemble.
    pub fn to_bits(self) -> u32 {
        self.0
    }

    /// The models of a stored number; `None` if a bit belongs to no model.
    pub fn from_bits(bits: u32) -> Option<EnabledModels> {
        (bits & !EnabledModels::ALL.0 == 0).then_some(EnabledModels(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_models_read_back() {
        for models in [EnabledModels::ALL, EnabledModels::SPECTRAL, EnabledModels::default()] {
            let read = models.names().try_fold(EnabledModels::SPECTRAL, EnabledModels::with_named);
            assert_eq!(read, Some(models));
        }
        assert_eq!(EnabledModels::SPECTRAL.with_named("all"), Some(EnabledModels::ALL));
        for name in ["mean", "", "fremen", "pergam:3"] {
            assert_eq!(EnabledModels::ALL.with_named(name), None, "{name}");
        }
    }

    #[test]
    fn stored_numbers_stay_what_they_are() {
        let stored = [
            ("histogram", 1),
            ("calibrated", 2),
            ("pergam", 4),
            ("hypertime-em", 8),
            ("hypertime-km", 16),
            ("ensemble", 1 << 30),
        ];
        for (name, bits) in stored.into_iter().chain([("poisson", 32), ("spectral", 0)]) {
            let models = EnabledModels::SPECTRAL.with_named(name).unwrap();
            assert_eq!((models.to_bits(), EnabledModels::from_bits(bits)), (bits, Some(models)), "{name}");
        }
        assert_eq!(EnabledModels::from_bits(1 << 29), None);
    }

    #[test]
    fn the_cheap_models_and_the_ensemble_are_the_usual_ones() {
        let usual: Vec<&str> = EnabledModels::default().names().collect();
        assert_eq!(usual, ["spectral", "histogram", "calibrated", "poisson", "ensemble"]);
        let all = "spectral, histogram, calibrated, poisson, pergam, hypertime-em, hypertime-km and ensemble";
        assert_eq!(EnabledModels::all_names(), all);
    }
}
