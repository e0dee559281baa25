//! How a state is reported.
//!
//! Invariant: durations are whole seconds within their ranges.

use tidemap_model::{Reporting, RowKind, StatedReporting, time::NANOS_PER_SEC};

use super::{
    InvalidField,
    time::{duration, nanos_from_duration},
};
use crate::v1;

/// Reads the stated reporting of a state.
///
/// # Errors
/// The invalid field.
pub fn reporting_from_wire(field: &str, wire: &v1::StateReporting) -> Result<StatedReporting, InvalidField> {
    let kind = match v1::RowKind::try_from(wire.kind) {
        Ok(v1::RowKind::Unspecified | v1::RowKind::Samples) => RowKind::Samples,
        Ok(v1::RowKind::Changes) => RowKind::Changes,
        Ok(v1::RowKind::Events) => RowKind::Events,
        Err(_) => {
            return Err(InvalidField::new(format!("{field}.kind"), format!("{} is not a kind of rows", wire.kind)));
        }
    };
    let secs = |name: &str, wire: &Option<prost_types::Duration>| {
        let Some(wire) = wire else { return Ok(None) };
        let field = format!("{field}.{name}");
        let nanos = nanos_from_duration(&field, *wire)?;
        let secs = u32::try_from(nanos / NANOS_PER_SEC).ok().filter(|_| nanos % NANOS_PER_SEC == 0);
        secs.map(Some).ok_or_else(|| InvalidField::new(field, "it must be whole seconds, at most 366 days"))
    };
    let stated = StatedReporting::new(kind, secs("hold_max", &wire.hold_max)?, secs("step", &wire.step)?);
    stated.map_err(|error| InvalidField::new(field, error))
}

/// The stated reporting of a state, for the wire.
#[must_use]
pub fn stated_reporting_to_wire(stated: StatedReporting) -> v1::StateReporting {
    let kind = match stated.kind() {
        RowKind::Samples => v1::RowKind::Samples,
        RowKind::Changes => v1::RowKind::Changes,
        RowKind::Events => v1::RowKind::Events,
    };
    let span = |secs: u32| duration(i64::from(secs) * NANOS_PER_SEC);
    v1::StateReporting { kind: kind.into(), hold_max: stated.max_secs().map(span), step: stated.step_secs().map(span) }
}

/// How a state is reported, for the wire; `None` for samples.
#[must_use]
pub fn reporting_to_wire(reporting: Reporting) -> Option<v1::StateReporting> {
    reporting.may_end().then(|| stated_reporting_to_wire(reporting.into()))
}
