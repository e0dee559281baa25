//! A map's fixed properties as a record, and back.
//!
//! Invariant: `decode(encode(spec)) == spec`.

use prost::Message as _;
use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::{Evidence, GridSpec, Retention, SensorNoise},
};
use tidemap_layout::map as layout;
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_model::{EnabledModels, OrderCriterion, Periodicities, PeriodicityDefinition, Zone};

use super::Invalid;

/// The record of a map.
pub(crate) fn encode(spec: &MapSpec) -> layout::MapSpec {
    let (harmonics_base_nanos, harmonics_count, period_nanos) = match spec.periodicities.definition() {
        PeriodicityDefinition::Harmonics { base_nanos, count } => (*base_nanos, *count, Vec::new()),
        PeriodicityDefinition::List { period_nanos } => (0, 0, period_nanos.clone()),
    };
    let criterion = match spec.criterion {
        OrderCriterion::SquaredError => 1,
        OrderCriterion::ZeroOne => 2,
    };
    layout::MapSpec {
        name: spec.name.as_str().to_owned(),
        zone: spec.zone.name().to_owned(),
        harmonics_base_nanos,
        harmonics_count,
        period_nanos,
        criterion,
        created_nanos: spec.created_nanos,
        retention: Some(encode_retention(spec.retention)),
        grid: spec.grid.as_ref().map(encode_grid),
        half_life_nanos: spec.half_life_nanos.unwrap_or(0),
        prior_bits: spec.prior.to_bits(),
        models: spec.models.to_bits(),
        has_real_clock: spec.has_real_clock,
    }
}

/// The fixed properties of a map as bytes, for other daemons.
#[must_use]
pub fn encode_spec(spec: &MapSpec) -> Vec<u8> {
    encode(spec).encode_to_vec()
}

/// The fixed properties of a map from [`encode_spec`].
///
/// # Errors
/// Returns a description of the fault if the bytes or the properties are not valid.
pub fn decode_spec(bytes: &[u8]) -> Result<MapSpec, String> {
    decode(layout::MapSpec::decode(bytes).map_err(|error| error.to_string())?)
}

pub(crate) fn decode(message: layout::MapSpec) -> Result<MapSpec, String> {
    let periodicities = if message.harmonics_count > 0 {
        Periodicities::harmonics(message.harmonics_base_nanos, message.harmonics_count)
    } else {
        Periodicities::list(message.period_nanos)
    };
    Ok(MapSpec {
        name: MapName::new(&message.name).map_err(|error| error.to_string())?,
        // The zone is in this version's database, unless a version with a newer database wrote it.
        zone: Zone::named(&message.zone).map_err(|error| error.to_string())?,
        periodicities: periodicities.map_err(|error| error.to_string())?,
        criterion: match message.criterion {
            1 => OrderCriterion::SquaredError,
            2 => OrderCriterion::ZeroOne,
            other => return Err(format!("order criterion {other} is not known")),
        },
        created_nanos: message.created_nanos,
        half_life_nanos: Some(message.half_life_nanos).filter(|&nanos| nanos != 0),
        prior: match f64::from_bits(message.prior_bits) {
            prior if (0.0..=1.0).contains(&prior) => prior,
            other => return Err(format!("prior {other} is not between 0 and 1")),
        },
        retention: decode_retention(message.retention.ok_or("it has no retention")?)?,
        models: decode_models(message.models)?,
        has_real_clock: message.has_real_clock,
        grid: message.grid.map(decode_grid).transpose()?,
    })
}

fn decode_models(bits: u32) -> Result<EnabledModels, String> {
    EnabledModels::from_bits(bits).ok_or_else(|| format!("models {bits} are not all known"))
}

fn encode_retention(retention: Retention) -> layout::Retention {
    match retention {
        Retention::None => layout::Retention { kind: 0, nanos: 0 },
        Retention::Duration(nanos) => layout::Retention { kind: 1, nanos },
        Retention::Forever => layout::Retention { kind: 2, nanos: 0 },
    }
}

fn decode_retention(message: layout::Retention) -> Result<Retention, String> {
    match message.kind {
        0 => Ok(Retention::None),
        1 => Ok(Retention::Duration(message.nanos)),
        2 => Ok(Retention::Forever),
        other => Err(format!("retention {other} is not known")),
    }
}

fn encode_grid(grid: &GridSpec) -> layout::GridSpec {
    layout::GridSpec {
        frame_id: grid.frame_id.clone(),
        is_flat: grid.is_flat,
        resolution_bits: grid.resolution_m.to_bits(),
        origin_bits: grid.origin_m.iter().map(|origin| origin.to_bits()).collect(),
        extent: grid.extent.as_ref().map(encode_box),
        hit_bits: grid.sensor.hit.to_bits(),
        false_alarm_bits: grid.sensor.false_alarm.to_bits(),
        prior_bits: grid.sensor.prior.to_bits(),
        retention: Some(encode_retention(grid.retention)),
        half_life_nanos: grid.half_life_nanos.unwrap_or(0),
    }
}

fn decode_grid(message: layout::GridSpec) -> Result<GridSpec, String> {
    let origin: Vec<f64> = message.origin_bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    let grid = GridSpec {
        frame_id: message.frame_id,
        is_flat: message.is_flat,
        resolution_m: f64::from_bits(message.resolution_bits),
        origin_m: origin.try_into().map_err(|_| "the origin of the grid is not three numbers")?,
        extent: message.extent.as_ref().map(decode_box).transpose()?,
        sensor: SensorNoise {
            hit: f64::from_bits(message.hit_bits),
            false_alarm: f64::from_bits(message.false_alarm_bits),
            prior: f64::from_bits(message.prior_bits),
        },
        retention: decode_retention(message.retention.unwrap_or_default())?,
        half_life_nanos: Some(message.half_life_nanos).filter(|&nanos| nanos != 0),
        evidence: Evidence::default(),
    };
    grid.check().map_err(|error| error.to_string())?;
    Ok(grid)
}

fn encode_box(cells: &CellBox) -> layout::CellBox {
    let corner = |cell: CellIndex| vec![cell.x, cell.y, cell.z];
    layout::CellBox { min: corner(cells.min), max: corner(cells.max) }
}

/// The cells that scans are pictures of; `None` if there are none.
pub(crate) fn encode_shown(cells: &CellBox) -> Option<layout::CellBox> {
    (!cells.is_empty()).then(|| encode_box(cells))
}

/// The cells that scans are pictures of; an empty box if no scan states them.
pub(crate) fn decode_shown(message: Option<&layout::CellBox>) -> Result<CellBox, Invalid> {
    message.map_or(Ok(CellBox::default()), decode_box)
}

fn decode_box(message: &layout::CellBox) -> Result<CellBox, Invalid> {
    let corner = |cell: &[i32]| match *cell {
        [x, y, z] => Ok(CellIndex { x, y, z }),
        _ => Err("a corner of the grid is not three numbers"),
    };
    Ok(CellBox { min: corner(&message.min)?, max: corner(&message.max)? })
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    #[test]
    fn what_scans_show_has_these_bytes() {
        let shown = CellBox { min: CellIndex { x: -304, y: 61, z: 0 }, max: CellIndex { x: 96, y: 361, z: 1 } };
        let message = encode_shown(&shown).expect("some cells");
        // Two lists of zigzag varints.
        let bytes = [0x0a, 4, 0xdf, 0x04, 0x7a, 0, 0x12, 5, 0xc0, 0x01, 0xd2, 0x05, 2];
        assert_eq!(message.encode_to_vec(), bytes);
        assert_eq!(decode_shown(Some(&message)), Ok(shown));
        assert_eq!(encode_shown(&CellBox::default()), None);
        assert_eq!(decode_shown(None), Ok(CellBox::default()), "older records have no value");
        let cut = layout::CellBox { min: vec![1, 2], max: vec![3, 4, 5] };
        assert!(decode_shown(Some(&cut)).is_err());
    }
}
