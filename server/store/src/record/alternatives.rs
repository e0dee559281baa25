//! The training data and models of a state apart from its spectrum, as a message, and back.
//!
//! Invariant: every number is read back bit by bit; a value that is read has passed the constructors of the model.

use tidemap_layout::map as layout;
use tidemap_model::{
    Alternatives, AlternativesParts, GapsParts, InvalidParts, LocalDay, Periodicities, PersistenceParts, StateKind,
    TrainedModelParts, TrainingRecordParts,
    models::{CalibratedParts, ChangeAlarmParts, DayErrors, HourTableParts, OrderGainsParts},
};

use super::{Invalid, doubles, fields, trained};

/// Hours of a week, with two numbers each.
const WEEK: usize = 168 * 2;
/// Hours of a weekday and of a day of the weekend, with three numbers each.
const DAYS: usize = 48 * 3;

/// Slots of ten minutes of a week.
const SLOTS: usize = 1008;

/// The message. `weight`: total weight of the observations, if it differs from their number.
pub(crate) fn encode(alternatives: &Alternatives, weight: Option<f64>) -> layout::Alternatives {
    let parts = alternatives.to_parts();
    let mut hours = Vec::with_capacity((WEEK + DAYS) * 8);
    doubles::push(&mut hours, parts.hours.cells.as_flattened());
    doubles::push(&mut hours, parts.hours.days.as_flattened());
    layout::Alternatives {
        hours,
        error_sums_bits: parts.error_sums.iter().map(|sum| sum.to_bits()).collect(),
        errors_last_day: parts.last_day.map(|day| day.0),
        folded_day: parts.learned_day.map(|day| day.0),
        choice: u32::from(parts.choice),
        weight_bits: weight.map(f64::to_bits),
        alarm: Some(encode_alarm(parts.alarm)),
        pairs: parts.succession.pairs,
        change_rate_sum_bits: parts.succession.change_rate_sum.to_bits(),
        last: parts
            .succession
            .last
            .map(|(nanos, value)| layout::LastObservation { nanos, value_bits: value.to_bits() }),
        supported: u32::from(parts.supported),
        days: parts.days,
        calibrated: parts.trained.iter().find_map(encode_calibrated),
        trained: trained::encode(&parts.trained),
        since: parts.since.map(|day| day.0),
        gains_bits: encode_gains(parts.gains),
        gaps: parts.gaps.count,
        changes_bits: parts.changes.to_bits(),
        ensemble: parts.ensemble.map(fields::write),
        numbers: parts.numbers.map(fields::write),
        kept_gaps: parts.gaps.kept.iter().flat_map(|&(number, secs)| [number, u64::from(secs)]).collect(),
    }
}

pub(super) fn encode_alarm(alarm: ChangeAlarmParts) -> layout::Alarm {
    let history = alarm.kinds.iter().flat_map(|kind| [kind.days, kind.mean, kind.variance]);
    layout::Alarm {
        history_bits: history.map(f64::to_bits).collect(),
        typical_observations_bits: alarm.typical_observations.to_bits(),
        sum_bits: alarm.sum.to_bits(),
        last_day: alarm.last_day.map(|day| day.0),
        alarm_day: alarm.alarm_day.map(|day| day.0),
    }
}

pub(super) fn decode_alarm(message: Option<&layout::Alarm>) -> Result<ChangeAlarmParts, Invalid> {
    const ALARM: Invalid = "a change alarm is not valid";
    let alarm = message.ok_or(ALARM)?;
    let history: Vec<f64> = alarm.history_bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    let ([weekdays, weekends], []) = history.as_chunks::<3>() else { return Err(ALARM) };
    let kind = |&[days, mean, variance]: &[f64; 3]| DayErrors { days, mean, variance };
    Ok(ChangeAlarmParts {
        kinds: [kind(weekdays), kind(weekends)],
        typical_observations: f64::from_bits(alarm.typical_observations_bits),
        sum: f64::from_bits(alarm.sum_bits),
        last_day: alarm.last_day.map(LocalDay),
        alarm_day: alarm.alarm_day.map(LocalDay),
    })
}

/// Encodes the gains; empty before the first day.
pub(super) fn encode_gains(gains: OrderGainsParts) -> Vec<u64> {
    if gains == OrderGainsParts::default() {
        return Vec::new();
    }
    vec![gains.days.to_bits(), gains.sum.to_bits(), gains.squares.to_bits()]
}

pub(super) fn decode_gains(bits: &[u64]) -> Result<OrderGainsParts, Invalid> {
    match *bits {
        [] => Ok(OrderGainsParts::default()),
        [days, sum, squares] => Ok(OrderGainsParts {
            days: f64::from_bits(days),
            sum: f64::from_bits(sum),
            squares: f64::from_bits(squares),
        }),
        _ => Err("the gains of the orders of a state are not three numbers"),
    }
}

fn decode_gaps(message: &layout::Alternatives) -> Result<GapsParts, Invalid> {
    const GAPS: Invalid = "the times between the readings of a state are not valid";
    let (kept, rest) = message.kept_gaps.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(GAPS);
    }
    let gap = |&[number, secs]: &[u64; 2]| Ok((number, u32::try_from(secs).map_err(|_| GAPS)?));
    Ok(GapsParts { count: message.gaps, kept: kept.iter().map(gap).collect::<Result<_, Invalid>>()? })
}

fn encode_calibrated(record: &TrainingRecordParts) -> Option<layout::Calibrated> {
    let TrainedModelParts::Calibrated(model) = &record.model else { return None };
    let mut profile = Vec::with_capacity(SLOTS * 8);
    doubles::push(&mut profile, &model.profile);
    Some(layout::Calibrated {
        day: record.day.0,
        error_sum_bits: record.error_sum.map(f64::to_bits),
        observations: model.observations,
        lowest_bits: model.lowest.to_bits(),
        highest_bits: model.highest.to_bits(),
        profile,
    })
}

pub(crate) fn decode(
    state_kind: StateKind,
    message: &layout::Alternatives,
    periodicities: &Periodicities,
) -> Result<Alternatives, String> {
    if message.hours.len() != (WEEK + DAYS) * 8 {
        return Err("the table of the hours of a state does not have its length".to_owned());
    }
    let mut numbers = Vec::with_capacity(WEEK + DAYS);
    doubles::take(&message.hours, &mut numbers);
    let (week, days) = numbers.split_at(WEEK);
    let calibrated = message.calibrated.as_ref().map(decode_calibrated).transpose()?;
    let invalid = |error: InvalidParts| error.to_string();
    let ensemble = message.ensemble.as_ref().map(|message| fields::read(Box::default(), message));
    let of_numbers = message.numbers.as_ref().map(|message| fields::read(Box::default(), message));
    let parts = AlternativesParts {
        hours: HourTableParts { cells: week.as_chunks::<2>().0.to_vec(), days: days.as_chunks::<3>().0.to_vec() },
        error_sums: message.error_sums_bits.iter().map(|&bits| f64::from_bits(bits)).collect(),
        last_day: message.errors_last_day.map(LocalDay),
        learned_day: message.folded_day.map(LocalDay),
        choice: u8::try_from(message.choice).map_err(|_| "the chosen model of a state is not known")?,
        alarm: decode_alarm(message.alarm.as_ref())?,
        succession: PersistenceParts {
            pairs: message.pairs,
            change_rate_sum: f64::from_bits(message.change_rate_sum_bits),
            last: message.last.as_ref().map(|last| (last.nanos, f64::from_bits(last.value_bits))),
        },
        gaps: decode_gaps(message)?,
        changes: f64::from_bits(message.changes_bits),
        gains: decode_gains(&message.gains_bits)?,
        supported: u8::try_from(message.supported).map_err(|_| "the supported order of a state is too high")?,
        days: message.days,
        since: message.since.map(LocalDay),
        ensemble: ensemble.transpose().map_err(invalid)?,
        numbers: of_numbers.transpose().map_err(invalid)?,
        trained: calibrated.into_iter().chain(trained::decode(&message.trained, periodicities)?).collect(),
    };
    Alternatives::from_parts_of(state_kind, parts).map_err(invalid)
}

fn decode_calibrated(message: &layout::Calibrated) -> Result<TrainingRecordParts, Invalid> {
    if message.profile.len() != SLOTS * 8 {
        return Err("the calibrated profile of a state does not have its length");
    }
    let mut profile = Vec::with_capacity(SLOTS);
    doubles::take(&message.profile, &mut profile);
    Ok(TrainingRecordParts {
        model: TrainedModelParts::Calibrated(CalibratedParts {
            observations: message.observations,
            lowest: f64::from_bits(message.lowest_bits),
            highest: f64::from_bits(message.highest_bits),
            profile,
        }),
        day: LocalDay(message.day),
        error_sum: message.error_sum_bits.map(f64::from_bits),
    })
}
