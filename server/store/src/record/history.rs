//! Exact observations of a state, and the small models of a tile's cells, as records of a history file, and back.
//!
//! Invariant: `decode(encode(x)) == x` to the last bit, or `encode` refuses.

use tidemap_layout::history as layout;
use tidemap_map::{
    history::{
        OutlierComponent, OutlierModel,
        origins::{OriginRun, Origins},
    },
    ids::{ProducerId, StateId},
};
use tidemap_model::Sample;

use super::{Invalid, cells::place, columns, offsets};

/// Limit of the number of observations in one record. Constant columns take no space, so the length of the payload does
/// not limit this number.
pub(crate) const SAMPLES_MAX: usize = 1 << 20;

/// Encodes one record. `origins`: the origins of `samples`.
pub(crate) fn encode_samples(
    state: StateId,
    samples: &[Sample],
    origins: &Origins,
) -> Result<layout::StateSamples, Invalid> {
    if origins.each().count() != samples.len() {
        return Err("the origins are not as many as the observations");
    }
    let mut next = 0_u64;
    let steps = origins.runs.iter().map(|run| {
        let step = run.first.wrapping_sub(next).cast_signed();
        next = run.first.wrapping_add(u64::from(run.count));
        step
    });
    let nanos: Vec<i64> = samples.iter().map(|sample| sample.utc_nanos).collect();
    let values: Vec<f64> = samples.iter().map(|sample| sample.value).collect();
    let (times, time_runs) = columns::encode_times_in_runs(&nanos)?;
    let (value_encoding, values, value_runs) = columns::encode_values_in_runs(&values)?;
    let (offset_counts, offset_secs) = offsets::encode(samples.iter().map(|sample| sample.offset_secs));
    Ok(layout::StateSamples {
        state: state.0,
        count: u32::try_from(samples.len()).map_err(|_| "there are more observations than one record may hold")?,
        first_time_nanos: times.first_nanos,
        time_unit_nanos: times.unit_nanos,
        times: times.differences,
        value_encoding,
        values,
        offset_counts,
        offset_secs,
        run_counts: origins.runs.iter().map(|run| run.count).collect(),
        run_producers: origins.runs.iter().map(|run| run.producer.0).collect(),
        run_steps: steps.collect(),
        ahead: origins.ahead,
        arrived: origins.arrived,
        is_early: origins.is_early,
        is_crowded: origins.is_crowded,
        value_runs,
        time_runs,
    })
}

/// The origins of the observations of a record.
pub(crate) fn decode_origins(message: &layout::StateSamples) -> Result<Origins, Invalid> {
    let layout::StateSamples { count, run_counts, run_producers, run_steps, ahead, .. } = message;
    let total = run_counts.iter().map(|&count| u64::from(count)).sum::<u64>();
    let is_sound = run_producers.len() == run_counts.len() && run_steps.len() == run_counts.len();
    if !is_sound || total != u64::from(*count) || ahead > count {
        return Err("the origins are not as many as the observations");
    }
    let mut next = 0_u64;
    let runs = run_counts.iter().zip(run_producers).zip(run_steps).map(|((&count, &producer), step)| {
        let first = next.wrapping_add(step.cast_unsigned());
        next = first.wrapping_add(u64::from(count));
        OriginRun { producer: ProducerId(producer), first, count }
    });
    let runs = runs.collect();
    let (arrived, is_early, is_crowded) = (message.arrived, message.is_early, message.is_crowded);
    Ok(Origins { runs, ahead: *ahead, arrived, is_early, is_crowded })
}

pub(crate) fn decode_samples(message: &layout::StateSamples) -> Result<Vec<Sample>, Invalid> {
    let count = message.count as usize;
    if count > SAMPLES_MAX {
        return Err("there are more observations than one record may hold");
    }
    let times = columns::Times {
        first_nanos: message.first_time_nanos,
        unit_nanos: message.time_unit_nanos,
        differences: &message.times,
    };
    let nanos = columns::decode_times_in_runs(&times, &message.time_runs, count)?;
    let values = columns::decode_values_in_runs(message.value_encoding, &message.values, &message.value_runs, count)?;
    let offsets = offsets::decode(&message.offset_counts, &message.offset_secs, count)?;
    let samples = nanos.into_iter().zip(values).zip(offsets);
    Ok(samples.map(|((utc_nanos, value), offset_secs)| Sample { utc_nanos, offset_secs, value }).collect())
}

/// Encodes small models of the cells of a tile.
pub(crate) fn encode_models(models: &[OutlierModel]) -> Result<Vec<u8>, Invalid> {
    let mut out = Vec::new();
    for model in models {
        out.extend(model.cell.to_le_bytes());
        out.extend(model.mean.to_le_bytes());
        out.push(u8::try_from(model.components.len()).map_err(|_| "a small model has too many components")?);
        for component in &model.components {
            out.extend(component.periodicity.to_le_bytes());
            out.extend(component.gamma_re.to_le_bytes());
            out.extend(component.gamma_im.to_le_bytes());
        }
    }
    Ok(out)
}

pub(crate) fn decode_models(mut bytes: &[u8]) -> Result<Vec<OutlierModel>, Invalid> {
    fn take<const N: usize>(bytes: &mut &[u8]) -> Result<[u8; N], Invalid> {
        let (taken, rest) = bytes.split_first_chunk::<N>().ok_or("the small models are cut off")?;
        *bytes = rest;
        Ok(*taken)
    }
    let mut models = Vec::new();
    while !bytes.is_empty() {
        let cell = place(u32::from(u16::from_le_bytes(take(&mut bytes)?)))?;
        let mean = f32::from_le_bytes(take(&mut bytes)?);
        let [count] = take::<1>(&mut bytes)?;
        let mut components = Vec::with_capacity(usize::from(count).min(bytes.len() / 10));
        for _ in 0..count {
            components.push(OutlierComponent {
                periodicity: u16::from_le_bytes(take(&mut bytes)?),
                gamma_re: f32::from_le_bytes(take(&mut bytes)?),
                gamma_im: f32::from_le_bytes(take(&mut bytes)?),
            });
        }
        models.push(OutlierModel { cell, mean, components });
    }
    Ok(models)
}
