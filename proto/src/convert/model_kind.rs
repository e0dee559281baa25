//! Kinds of models, by their names.
//!
//! Invariant: every kind of the catalogue has its number on the wire (a test in `round_trips.rs` holds this), and a
//! kind that is added there needs no code here.

use tidemap_model::selector::ModelKind;

use crate::v1;

/// The kind on the wire has the name of the catalogue, in capitals: `hypertime-em` is `MODEL_KIND_HYPERTIME_EM`.
const MODEL_KIND: &str = "MODEL_KIND_";

/// The kind of a model, with default parameters; `None` for [`v1::ModelKind::Unspecified`].
pub(super) fn model_kind_from_wire(wire: v1::ModelKind) -> Option<ModelKind> {
    let name = wire.as_str_name().strip_prefix(MODEL_KIND)?.to_lowercase().replace('_', "-");
    ModelKind::named(&name)
}

/// The kind of a model for the wire, without its parameters.
pub(super) fn model_kind_to_wire(kind: ModelKind) -> v1::ModelKind {
    let name = kind.name().to_uppercase().replace('-', "_");
    v1::ModelKind::from_str_name(&format!("{MODEL_KIND}{name}")).unwrap_or_default()
}
