//! A map's fixed properties as a record, and back.
//!
//! Invariant: `decode(encode(spec)) == spec`.

use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_migrations::v1::map as v1;
use tidemap_model::{OrderCriterion, Periodicities, PeriodicityDefinition, Zone};

pub(crate) fn encode(spec: &MapSpec) -> v1::MapSpec {
    let (harmonics_base_nanos, harmonics_count, period_nanos) = match spec.periodicities.definition() {
        PeriodicityDefinition::Harmonics { base_nanos, count } => (*base_nanos, *count, Vec::new()),
        PeriodicityDefinition::List { period_nanos } => (0, 0, period_nanos.clone()),
    };
    let criterion = match spec.criterion {
        OrderCriterion::SquaredError => 1,
        OrderCriterion::ZeroOne => 2,
    };
    v1::MapSpec {
        name: spec.name.as_str().to_owned(),
        zone: spec.zone.name().to_owned(),
        harmonics_base_nanos,
        harmonics_count,
        period_nanos,
        criterion,
        created_nanos: spec.created_nanos,
    }
}

pub(crate) fn decode(message: v1::MapSpec) -> Result<MapSpec, String> {
    let periodicities = if message.harmonics_count > 0 {
        Periodicities::harmonics(message.harmonics_base_nanos, message.harmonics_count)
    } else {
        Periodicities::list(message.period_nanos)
    };
    Ok(MapSpec {
        name: MapName::new(&message.name).map_err(|error| error.to_string())?,
        // A later version's database of zones may have renamed one, never this version's own.
        zone: Zone::named(&message.zone).map_err(|error| error.to_string())?,
        periodicities: periodicities.map_err(|error| error.to_string())?,
        criterion: match message.criterion {
            1 => OrderCriterion::SquaredError,
            2 => OrderCriterion::ZeroOne,
            other => return Err(format!("order criterion {other} is not known")),
        },
        created_nanos: message.created_nanos,
    })
}
