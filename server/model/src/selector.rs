//! A model as a query names it: its kind and parameters, its order, and its blend with the newest reading.
//!
//! Invariant: the model that predicts a state depends on the query and on the choice of the last update alone.

pub use crate::catalogue::ModelKind;
use crate::{ORDER_MAX, StateModel};

mod blend;
mod name;

pub use blend::Blend;
pub use name::InvalidModel;

/// A model as a query names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// The kind of the model.
    pub kind: ModelKind,
    /// Number of spectral components, at most [`ORDER_MAX`]; by default the order that the last update chose. Ignored
    /// by kinds that have no order.
    pub order: Option<usize>,
    /// How the newest reading is blended in.
    pub blend: Blend,
}

impl ModelSelector {
    /// The selector of the model that an update chose.
    #[must_use]
    pub fn of_choice(kind: ModelKind, model: &StateModel) -> ModelSelector {
        let order = (kind == ModelKind::Spectral).then(|| model.order());
        ModelSelector { kind, order, ..ModelSelector::default() }
    }

    /// The model that predicts this state. If the query leaves the choice open, it is the choice of the last update.
    #[must_use]
    pub fn answering(self, model: &StateModel) -> ModelSelector {
        match (self.kind, self.order) {
            (ModelKind::Auto, None) => {
                ModelSelector { blend: self.blend, ..ModelSelector::of_choice(model.answers(), model) }
            }
            // The choice of the last update predicts a state that has no ensemble.
            (ModelKind::Ensemble, _) if model.ensemble().is_none() => {
                ModelSelector { kind: ModelKind::Auto, order: None, ..self }.answering(model)
            }
            _ => self.answering_with(model.order()),
        }
    }

    /// The model that predicts a cell whose spectral model has this order: cells have no other model to choose.
    #[must_use]
    pub fn answering_with(self, order: usize) -> ModelSelector {
        match self.kind {
            ModelKind::Auto | ModelKind::Spectral => {
                ModelSelector { kind: ModelKind::Spectral, order: Some(self.order_or(order)), ..self }
            }
            _ => self,
        }
    }

    /// Whether the model predicts a state only from the data that the last update published, without newer values. The
    /// default model of a cell does so, too.
    pub fn is_of_generation(self) -> bool {
        use ModelKind::{Auto, Ensemble, Mean, Spectral};
        !self.is_blended() && !self.knows_newest() && matches!(self.kind, Auto | Ensemble | Mean | Spectral)
    }

    /// Whether the newest readings of a state are part of the forecast, by their weight at its lead time: the default
    /// model. The newest value of a cell is not part of it.
    #[must_use]
    #[inline]
    pub fn knows_newest(self) -> bool {
        self.leaves_choice() && !self.is_blended()
    }

    /// The model of a state without its newest readings: the ensemble in place of the default model.
    #[must_use]
    pub fn long_term(self) -> ModelSelector {
        if self.knows_newest() { ModelSelector { kind: ModelKind::Ensemble, ..self } } else { self }
    }

    /// Order of the spectral model that predicts this state; 0 for a constant model or another kind.
    pub fn order_for(&self, model: &StateModel) -> usize {
        let is_other = self.leaves_choice() && model.answers() != ModelKind::Spectral;
        if self.kind.has_order() && !is_other { self.order_or(model.order()) } else { 0 }
    }

    /// Whether the query leaves the choice of the model to the updates.
    #[must_use]
    #[inline]
    pub fn leaves_choice(self) -> bool {
        self.kind == ModelKind::Auto && self.order.is_none()
    }

    /// Whether the newest reading is blended in.
    #[must_use]
    #[inline]
    pub fn is_blended(self) -> bool {
        self.blend != Blend::None
    }

    /// The requested order, or the order that the last update chose; at most [`ORDER_MAX`].
    #[must_use]
    #[inline]
    pub fn order_or(&self, chosen: usize) -> usize {
        self.order.unwrap_or(chosen).min(ORDER_MAX)
    }
}
