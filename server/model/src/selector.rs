//! A model as a query names it: its kind and parameters, its order, and whether the last value is blended in.
//!
//! Invariant: the answering model of a state depends on the query and on what the last update chose alone.

pub use crate::catalogue::ModelKind;
use crate::{MemoryBasis, ORDER_MAX, Persistence, StateModel};

mod name;

pub use name::InvalidModel;

/// A model as a query names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ModelSelector {
    /// Which model.
    pub kind: ModelKind,
    /// Number of spectral components, at most [`ORDER_MAX`]; by default the order that the last update chose. Ignored
    /// by kinds that have no order.
    pub order: Option<usize>,
    /// Blends the last value in (T-RO eq. 12 and 13).
    pub persistence: bool,
    /// Blends the last value in by the rates of a two-state chain, which allow for changes that nobody saw (RAS 2017,
    /// eq. 6). With [`ModelSelector::persistence`] it is ignored.
    pub memory: bool,
    /// Draws the prediction towards what the newest readings say, as far as they have proved right that far ahead: see
    /// [`Belief`](crate::Belief). With one of the others it is ignored.
    pub belief: bool,
}

impl ModelSelector {
    /// The model that a choice of an update stands for.
    #[must_use]
    pub fn of_choice(kind: ModelKind, model: &StateModel) -> ModelSelector {
        let order = (kind == ModelKind::Spectral).then(|| model.order());
        ModelSelector { kind, order, ..ModelSelector::default() }
    }

    /// The model that predicts this state: what the last update chose, if the query leaves the choice to it.
    #[must_use]
    pub fn answering(self, model: &StateModel) -> ModelSelector {
        match (self.kind, self.order) {
            (ModelKind::Auto, None) => {
                let chosen = ModelSelector::of_choice(model.answers(), model);
                let ModelSelector { persistence, memory, belief, .. } = self;
                ModelSelector { persistence, memory, belief, ..chosen }
            }
            // A state that has no ensemble is predicted by what the last update chose.
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

    /// Whether it predicts from what the last update published alone, without newer values.
    pub fn is_of_generation(&self) -> bool {
        let is_plain = *self == ModelSelector { kind: self.kind, order: self.order, ..ModelSelector::default() };
        is_plain && matches!(self.kind, ModelKind::Auto | ModelKind::Mean | ModelKind::Spectral)
    }

    /// Order of the spectral model that predicts this state; 0 for a constant model or another kind.
    pub fn order_for(&self, model: &StateModel) -> usize {
        let is_other = self.kind == ModelKind::Auto && self.order.is_none() && model.answers() != ModelKind::Spectral;
        if self.kind.has_order() && !is_other { self.order_or(model.order()) } else { 0 }
    }

    /// Whether the last value is blended in.
    #[must_use]
    #[inline]
    pub fn is_blended(self) -> bool {
        self.persistence || self.memory || self.belief
    }

    /// A prediction `p` for a time, drawn towards the last value as this model does it; `p` itself if it does not. What
    /// has no [`Belief`](crate::Belief) has persistence in its place.
    #[must_use]
    pub fn blend(self, newest: &Persistence, basis: MemoryBasis, p: f64, utc_nanos: i64) -> f64 {
        match (self.persistence, self.memory, self.belief) {
            (true, ..) | (false, false, true) => newest.blend_of(basis.usual_change, p, utc_nanos),
            (false, true, _) => newest.remember(basis, p, utc_nanos),
            (false, false, false) => p,
        }
    }

    /// This model without the last value.
    #[must_use]
    #[inline]
    pub fn unblended(self) -> ModelSelector {
        ModelSelector { persistence: false, memory: false, belief: false, ..self }
    }

    /// The requested order, or the one that the last update chose; at most [`ORDER_MAX`].
    #[must_use]
    #[inline]
    pub fn order_or(&self, chosen: usize) -> usize {
        self.order.unwrap_or(chosen).min(ORDER_MAX)
    }
}
