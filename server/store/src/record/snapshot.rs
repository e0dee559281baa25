//! Producers, states and the counters of a snapshot as records, and back.
//!
//! Invariant: every number is read back bit by bit.

use std::{collections::HashSet, sync::Arc};

use tidemap_layout::map as layout;
use tidemap_map::{
    site::Site,
    snapshot::{ContentMark, MapSnapshot, ProducerMark, StateSnapshot},
};
use tidemap_model::{
    Accumulator, AccumulatorParts, Alternatives, AlternativesParts, Belief, Component, InvalidParts, LABELS, LocalDay,
    OrderErrors, OrderErrorsParts, Periodicities, Persistence, PersistenceParts, Recent, ShortRecord, SpectralModel,
    StateKind, StateModel,
};

use super::{
    Invalid, fields,
    ids::{decode_producer_key, decode_state_kind, encode_producer_key, encode_state_kind},
    rows, sensors, surprises, tables,
};

/// The counters of a snapshot. The counts must fit; [`check`] checks that.
pub(crate) fn encode(snapshot: &MapSnapshot) -> layout::Snapshot {
    layout::Snapshot {
        position: snapshot.position,
        replay_from: snapshot.replay_from,
        generation: snapshot.generation,
        cut_nanos: snapshot.cut_nanos,
        newest_nanos: snapshot.newest_nanos,
        producers: snapshot.producers.len() as u32,
        states: snapshot.states.len() as u32,
        // The limits of the tables allow fewer rows than 32 bits can count.
        table_rows: tables::count(&snapshot.site) as u32,
    }
}

/// Refuses a snapshot that could not be read back.
pub(crate) fn check(snapshot: &MapSnapshot) -> Result<(), Invalid> {
    if u32::try_from(snapshot.producers.len()).is_err() || u32::try_from(snapshot.states.len()).is_err() {
        return Err("it has more states or producers than can be numbered");
    }
    check_axes(&snapshot.states)?;
    check_labels(&snapshot.states)?;
    check_positions(&encode(snapshot))
}

/// Splits the name of an axis: the name of the vector or angle, whether it is an angle, and the number of the axis.
fn axis_of(state: &StateSnapshot) -> Option<(&str, bool, usize)> {
    let of_vector = state.name.as_axis().map(|(name, number)| (name, false, number));
    of_vector.or_else(|| state.name.as_angle_axis().map(|(name, number)| (name, true, number)))
}

/// Refuses vectors and angles with an axis that is missing, out of order or not continuous, or with the same name as
/// another state.
fn check_axes(states: &[StateSnapshot]) -> Result<(), Invalid> {
    let axis = |index: usize| states.get(index).and_then(axis_of);
    let mut vectors = HashSet::new();
    for (index, state) in states.iter().enumerate() {
        let Some((vector, is_angle, number)) = axis_of(state) else { continue };
        let is_whole = match number {
            0 => axis(index + 1) == Some((vector, is_angle, 1)),
            _ => index > 0 && axis(index - 1) == Some((vector, is_angle, number - 1)),
        };
        if !is_whole || state.kind != StateKind::Continuous {
            return Err("an axis of a vector or an angle is missing, out of order or of another kind");
        }
        if number == 0 && !vectors.insert(vector) {
            return Err("two vectors or angles have the same name");
        }
    }
    if !vectors.is_empty() && states.iter().any(|state| vectors.contains(state.name.as_str())) {
        return Err("a vector and a state have the same name");
    }
    Ok(())
}

/// Refuses categorical states with too few or too many labels, with labels that are not in a row or are not
/// probabilities, or with the same name as another state.
fn check_labels(states: &[StateSnapshot]) -> Result<(), Invalid> {
    let state_of = |label: &StateSnapshot| label.name.as_label().map(|(state, _)| state.to_owned());
    let mut known = HashSet::new();
    for labels in states.chunk_by(|one, other| state_of(one) == state_of(other)) {
        let Some(state) = labels.first().and_then(state_of) else { continue };
        if !LABELS.contains(&labels.len()) || labels.iter().any(|label| label.kind != StateKind::Probability) {
            return Err("a label of a categorical state is missing, or of another kind");
        }
        if !known.insert(state) {
            return Err("the labels of a categorical state are not in a row");
        }
    }
    if !known.is_empty() && states.iter().any(|state| known.contains(state.name.as_str())) {
        return Err("a categorical state and another one have the same name");
    }
    Ok(())
}

/// Checks the log positions: the replay must start at a position that exists in the log.
pub(crate) fn check_positions(message: &layout::Snapshot) -> Result<(), Invalid> {
    let is_sound = message.replay_from <= message.position.saturating_add(1);
    if is_sound { Ok(()) } else { Err("replay_from is beyond position + 1") }
}

/// A snapshot from its counters, its producers, its states and its site.
pub(crate) fn decode(
    message: &layout::Snapshot,
    producers: Vec<ProducerMark>,
    states: Vec<StateSnapshot>,
    site: Site,
) -> Result<MapSnapshot, Invalid> {
    check_positions(message)?;
    if producers.len() != message.producers as usize || states.len() != message.states as usize {
        return Err("states or producers are missing or too many");
    }
    if message.table_rows as usize != tables::count(&site) {
        return Err("rows of the site are missing or too many");
    }
    check_axes(&states)?;
    check_labels(&states)?;
    Ok(MapSnapshot {
        position: message.position,
        replay_from: message.replay_from,
        generation: message.generation,
        cut_nanos: message.cut_nanos,
        newest_nanos: message.newest_nanos,
        producers,
        states,
        site: Arc::new(site),
        grid: None,
        history: Vec::new(),
    })
}

pub(crate) fn encode_producer(id: u32, mark: &ProducerMark) -> layout::Producer {
    layout::Producer {
        id,
        key: Some(encode_producer_key(&mark.key)),
        incarnation: mark.incarnation,
        durable_sequence: mark.durable_sequence,
        content_crc: mark.content_crc,
        sensor: sensors::encode(mark.sensor),
        recent_sequences: mark.recent.iter().map(|recent| recent.sequence).collect(),
        recent_crcs: mark.recent.iter().map(|recent| recent.crc).collect(),
        received_nanos: mark.received_nanos,
        has_scans: mark.has_scans,
        newest_nanos: mark.newest_nanos,
        is_forgotten: mark.is_forgotten,
        introduced_by: mark.introduced_by.clone(),
    }
}

/// Decodes the producer, which must have the number `id`.
pub(crate) fn decode_producer(id: usize, message: &layout::Producer) -> Result<ProducerMark, Invalid> {
    if message.id as usize != id {
        return Err("a producer is missing or out of order");
    }
    let key = message.key.as_ref().ok_or("a producer has no name")?;
    if message.recent_sequences.len() != message.recent_crcs.len() {
        return Err("the CRCs of a producer do not fit its sequence numbers");
    }
    let recent = message.recent_sequences.iter().zip(&message.recent_crcs);
    let recent: Vec<_> = recent.map(|(&sequence, &crc)| ContentMark { sequence, crc }).collect();
    let durable = ContentMark { sequence: message.durable_sequence, crc: message.content_crc };
    let all = || recent.iter().chain([&durable]);
    if all().zip(all().skip(1)).any(|(before, after)| before.sequence >= after.sequence) {
        return Err("the CRCs of a producer are out of order");
    }
    Ok(ProducerMark {
        key: decode_producer_key(key)?,
        incarnation: message.incarnation,
        durable_sequence: message.durable_sequence,
        content_crc: message.content_crc,
        sensor: sensors::decode(message.sensor.as_ref())?,
        received_nanos: message.received_nanos,
        newest_nanos: message.newest_nanos,
        recent,
        has_scans: message.has_scans,
        is_forgotten: message.is_forgotten,
        introduced_by: message.introduced_by.clone(),
    })
}

/// A state with its sums.
pub(crate) fn encode_state(id: u32, state: &StateSnapshot, accumulator: AccumulatorParts) -> layout::State {
    encode_state_with(id, state, accumulator, state.model.alternatives().map(|known| known.to_parts()))
}

/// A state with its sums, and with these parts of its alternatives.
pub(crate) fn encode_state_with(
    id: u32,
    state: &StateSnapshot,
    accumulator: AccumulatorParts,
    known: Option<AlternativesParts>,
) -> layout::State {
    let persistence = state.persistence.to_parts();
    let spectral = state.model.spectral();
    let errors = state.model.errors().to_parts();
    let component = |component: &Component| layout::Component {
        periodicity: component.periodicity,
        re_bits: component.gamma_re.to_bits(),
        im_bits: component.gamma_im.to_bits(),
    };
    // If all observations have weight 1, their weight is their number.
    let weight = Some(accumulator.weight).filter(|&weight| weight != accumulator.observations as f64);
    layout::State {
        id,
        name: state.name.as_str().to_owned(),
        kind: encode_state_kind(&state.name, state.kind),
        observations: state.observations,
        pairs: persistence.pairs,
        change_rate_sum_bits: persistence.change_rate_sum.to_bits(),
        last: persistence.last.map(|(nanos, value)| layout::LastObservation { nanos, value_bits: value.to_bits() }),
        accumulator: Some(layout::Accumulator {
            observations: accumulator.observations,
            sum_bits: accumulator.sum.to_bits(),
            sum_squares_bits: accumulator.sum_squares.to_bits(),
            first_nanos: accumulator.first_nanos,
            last_nanos: accumulator.last_nanos,
            // At most 2,048.
            periodicities: accumulator.spectrum.len() as u32,
        }),
        spectrum: accumulator.spectrum.as_flattened().iter().flat_map(|number| number.to_le_bytes()).collect(),
        spectral: Some(layout::Spectral {
            mean_bits: spectral.mean().to_bits(),
            observations: spectral.observations(),
            components: spectral.components().iter().map(component).collect(),
        }),
        // At most 15.
        order: state.model.best_order() as u32,
        error_sums_bits: errors.sums.iter().map(|sum| sum.to_bits()).collect(),
        errors_last_day: errors.last_day.map(|day| day.0),
        alternatives: known.map(|parts| fields::write(AlternativesParts { weight, ..parts })),
        short: accumulator.short.map(|short| layout::ShortRecord {
            readings: short
                .readings
                .iter()
                .flat_map(|&(civil_nanos, value)| [civil_nanos.to_le_bytes(), value.to_le_bytes()])
                .flatten()
                .collect(),
            batches: short.batches,
        }),
        surprises: surprises::encode(state.model.surprises()),
        belief: state.model.belief().cloned().map(fields::write),
        recent: fields::pack(state.recent.spans()),
        sensor: state.model.sensor().map(sensors::encode_state_sensor),
        rows: rows::encode(&state.model, state.newest_row),
    }
}

fn decode_short(message: &layout::ShortRecord) -> Result<ShortRecord, String> {
    let (readings, rest) = message.readings.as_chunks::<16>();
    if !rest.is_empty() {
        return Err("the readings of a state do not have their length".to_owned());
    }
    let reading = |bytes: &[u8; 16]| {
        let ([civil_nanos, value], _) = bytes.as_chunks::<8>() else { return (0, 0.0) };
        (i64::from_le_bytes(*civil_nanos), f64::from_le_bytes(*value))
    };
    Ok(ShortRecord { readings: readings.iter().map(reading).collect(), batches: message.batches.clone() })
}

/// The place of the message of a state, which decides whether the message contains the spectrum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SpectrumIn {
    /// The message is in a checkpoint and contains the spectrum.
    Checkpoint,
    /// The message is in the index, which holds published data, and has no spectrum.
    Nowhere,
}

/// Decodes the state, which must have the number `id`.
pub(crate) fn decode_state(
    id: usize,
    message: &layout::State,
    periodicities: &Periodicities,
    spectrum: SpectrumIn,
) -> Result<StateSnapshot, String> {
    if message.id as usize != id {
        return Err("a state is missing or out of order".to_owned());
    }
    let persistence = PersistenceParts {
        pairs: message.pairs,
        change_rate_sum: f64::from_bits(message.change_rate_sum_bits),
        last: message.last.as_ref().map(|last| (last.nanos, f64::from_bits(last.value_bits))),
    };
    let (name, kind) = decode_state_kind(&message.name, message.kind)?;
    Ok(StateSnapshot {
        name,
        kind,
        observations: message.observations,
        persistence: Persistence::from_parts_of(kind, persistence).map_err(|error| error.to_string())?,
        recent: decode_recent(&message.recent).map_err(|error| error.to_string())?,
        newest_row: rows::decode_newest(message.rows.as_ref())?,
        model: Arc::new(decode_model(kind, message, periodicities, spectrum)?),
    })
}

fn decode_recent(bytes: &[u8]) -> Result<Recent, InvalidParts> {
    Recent::from_spans(&fields::unpack("the recent readings of a state", bytes)?)
}

fn decode_model(
    kind: StateKind,
    message: &layout::State,
    periodicities: &Periodicities,
    spectrum_in: SpectrumIn,
) -> Result<StateModel, String> {
    let sums = message.accumulator.as_ref().ok_or("a state has no accumulator")?;
    let spectral = message.spectral.as_ref().ok_or("a state has no spectral model")?;
    let (numbers, rest) = message.spectrum.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect();
    let (spectrum, odd) = numbers.as_chunks::<4>();
    if !rest.is_empty() || !odd.is_empty() || spectrum.len() != sums.periodicities as usize {
        return Err("a spectrum does not have its length".to_owned());
    }
    let invalid = |error: InvalidParts| error.to_string();
    let known = message.alternatives.as_ref().map(|known| fields::read(AlternativesParts::default(), known));
    let known = known.transpose().map_err(invalid)?;
    let weight = known.as_ref().and_then(|known| known.weight);
    let accumulator = AccumulatorParts {
        observations: sums.observations,
        weight: weight.unwrap_or(sums.observations as f64),
        sum: f64::from_bits(sums.sum_bits),
        sum_squares: f64::from_bits(sums.sum_squares_bits),
        first_nanos: sums.first_nanos,
        last_nanos: sums.last_nanos,
        spectrum: spectrum.to_vec(),
        short: message.short.as_ref().map(decode_short).transpose()?,
    };
    let component = |component: &layout::Component| Component {
        periodicity: component.periodicity,
        gamma_re: f64::from_bits(component.re_bits),
        gamma_im: f64::from_bits(component.im_bits),
    };
    let components = spectral.components.iter().map(component).collect();
    let error_sums: Vec<f64> = message.error_sums_bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    let errors = OrderErrorsParts {
        sums: error_sums.try_into().map_err(|_| "the sums of errors are not 16")?,
        last_day: message.errors_last_day.map(LocalDay),
    };
    let accumulator = match spectrum_in {
        SpectrumIn::Checkpoint => Accumulator::from_parts_of(kind, periodicities, accumulator),
        SpectrumIn::Nowhere => Accumulator::published_from_parts(kind, accumulator),
    };
    let model = StateModel::from_parts(
        accumulator.map_err(invalid)?,
        SpectralModel::from_parts_of(kind, f64::from_bits(spectral.mean_bits), spectral.observations, components)
            .map_err(invalid)?,
        message.order as usize,
        OrderErrors::from_parts(errors).map_err(invalid)?,
    )
    .map_err(invalid)?;
    let model = model.with_surprises(surprises::decode(message.surprises.as_ref())?);
    let model = match &message.belief {
        Some(known) => {
            let belief = fields::read(Belief::new(false), known).and_then(|known| known.of_kind(kind));
            model.with_belief(belief.map_err(invalid)?)
        }
        None => model,
    };
    let model = match &message.sensor {
        Some(_) if kind != StateKind::Probability => {
            return Err("a state has a sensor, and is no probability".to_owned());
        }
        Some(sensor) => model.with_sensor(sensors::decode_state_sensor(sensor)?),
        None => model,
    };
    let model = rows::decode(model, message.rows.as_ref())?;
    Ok(match known {
        Some(known) => {
            let known = Alternatives::from_parts_of(kind, known.with_periodicities(periodicities));
            model.with_alternatives(known.map_err(invalid)?)
        }
        None => model,
    })
}
