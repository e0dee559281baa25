//! The ensemble of a state as a message, and back.
//!
//! Invariant: every number is read back bit by bit. The constructor of the ensemble checks the numbers.

use tidemap_layout::ensemble as layout;
use tidemap_model::{ClassParts, EnsembleParts, LocalDay, StoredForecastParts};

use super::Invalid;

const INVALID: Invalid = "the ensemble of a state is not valid";

fn singles(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn read_singles(bytes: &[u8]) -> Result<Vec<f32>, Invalid> {
    let (numbers, rest) = bytes.as_chunks::<4>();
    if rest.is_empty() { Ok(numbers.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()) } else { Err(INVALID) }
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

fn read_bits<const N: usize>(bits: &[u64]) -> Result<[f64; N], Invalid> {
    let numbers: Vec<f64> = bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    numbers.try_into().map_err(|_| INVALID)
}

fn read_array<const N: usize>(bytes: &[u8]) -> Result<[f32; N], Invalid> {
    read_singles(bytes)?.try_into().map_err(|_| INVALID)
}

pub(crate) fn encode(parts: &EnsembleParts) -> layout::Ensemble {
    let [all, recent] = &parts.tables;
    let [slow_stack, fast_stack] = &parts.stacks;
    let day = |day: Option<LocalDay>| day.map(|day| day.0);
    let five_days = |&(day, mean, bins): &(i32, f32, f32)| layout::FiveDays {
        day,
        mean_bits: mean.to_bits(),
        bins_bits: bins.to_bits(),
    };
    layout::Ensemble {
        bins_bits: bits(&parts.bins),
        last_day: day(parts.last_day),
        all: singles(all),
        recent: singles(recent),
        alike: singles(&parts.alike),
        recall: parts.recall.clone(),
        residuals: parts.residuals.iter().map(|residual| residual.cast_unsigned()).collect(),
        residuals_day: day(parts.residuals_day),
        rotations: singles(&parts.rotations),
        five_days: parts.five_days.iter().map(five_days).collect(),
        season_first: day(parts.season_days[0]),
        season_last: day(parts.season_days[1]),
        gaps: parts.gaps.to_vec(),
        rhythm_bits: bits(&parts.rhythm),
        slow_stack: singles(slow_stack),
        fast_stack: singles(fast_stack),
        losses: singles(&parts.losses),
        classes: parts.classes.iter().map(encode_class).collect(),
        calibration: singles(&parts.calibration),
        smooth_bits: parts.smooth.as_ref().map_or_else(Vec::new, |(values, _)| bits(values)),
        smooth_bins_bits: parts.smooth.as_ref().map_or(0, |(_, bins)| bins.to_bits()),
    }
}

fn encode_class(class: &ClassParts) -> layout::Class {
    let numbers = [&class.losses[..], &class.explained, &[class.bins]].concat();
    let stored = |stored: &StoredForecastParts| layout::StoredForecast {
        day: stored.day.0,
        mean_bits: stored.mean.to_bits(),
        weeks: stored.weeks.clone(),
        rhythm_bits: bits(&stored.rhythm),
    };
    let [newer, older] = class.stored.each_ref().map(|before| before.as_ref().map(stored));
    layout::Class { numbers: singles(&numbers), newer, older }
}

pub(crate) fn decode(message: &layout::Ensemble) -> Result<EnsembleParts, Invalid> {
    let five_days = |five_days: &layout::FiveDays| {
        (five_days.day, f32::from_bits(five_days.mean_bits), f32::from_bits(five_days.bins_bits))
    };
    let classes: Vec<ClassParts> = message.classes.iter().map(decode_class).collect::<Result<_, Invalid>>()?;
    let smooth: Vec<f64> = message.smooth_bits.iter().map(|&bits| f64::from_bits(bits)).collect();
    Ok(EnsembleParts {
        bins: read_bits(&message.bins_bits)?,
        last_day: message.last_day.map(LocalDay),
        tables: [read_singles(&message.all)?, read_singles(&message.recent)?],
        alike: read_singles(&message.alike)?,
        recall: message.recall.clone(),
        residuals: message.residuals.iter().map(|residual| residual.cast_signed()).collect(),
        residuals_day: message.residuals_day.map(LocalDay),
        rotations: read_singles(&message.rotations)?,
        five_days: message.five_days.iter().map(five_days).collect(),
        season_days: [message.season_first.map(LocalDay), message.season_last.map(LocalDay)],
        gaps: message.gaps.as_slice().try_into().map_err(|_| INVALID)?,
        rhythm: read_bits(&message.rhythm_bits)?,
        stacks: [read_singles(&message.slow_stack)?, read_singles(&message.fast_stack)?],
        losses: read_array(&message.losses)?,
        classes: classes.try_into().map_err(|_| INVALID)?,
        calibration: read_array(&message.calibration)?,
        smooth: (!smooth.is_empty()).then(|| (smooth, f64::from_bits(message.smooth_bins_bits))),
    })
}

fn decode_class(message: &layout::Class) -> Result<ClassParts, Invalid> {
    let numbers = read_singles(&message.numbers)?;
    let (losses, rest) = numbers.split_first_chunk().ok_or(INVALID)?;
    let &[by_pool, by_mean, bins] = rest else { return Err(INVALID) };
    let stored = |stored: &layout::StoredForecast| {
        Ok::<StoredForecastParts, Invalid>(StoredForecastParts {
            day: LocalDay(stored.day),
            mean: f32::from_bits(stored.mean_bits),
            weeks: stored.weeks.clone(),
            rhythm: read_bits(&stored.rhythm_bits)?,
        })
    };
    let stored = [message.newer.as_ref().map(stored).transpose()?, message.older.as_ref().map(stored).transpose()?];
    Ok(ClassParts { losses: *losses, explained: [by_pool, by_mean], bins, stored })
}

#[cfg(test)]
mod tests {
    use prost::Message as _;
    use tidemap_model::{
        Ensemble, Sample,
        models::{Mean, Readings},
    };

    use super::*;

    /// An ensemble of a door that is open by day and observed in every half-hour of some days.
    fn ensemble(days: i64) -> Ensemble {
        let mut ensemble = Ensemble::new();
        for day in 0..days {
            let sample = |slot: i64| Sample {
                utc_nanos: (day * 48 + slot) * 1_800_000_000_000,
                offset_secs: 0,
                value: f64::from(u8::from((18..36).contains(&slot) && day % 7 < 5)),
            };
            let samples: Vec<Sample> = (0..48).map(sample).collect();
            let mean = Mean::train(Readings::new(&samples)).expect("readings");
            ensemble.learn_day(LocalDay(i32::try_from(day).expect("few")), &samples, &samples, &mean);
        }
        ensemble
    }

    #[test]
    fn an_ensemble_is_read_back_bit_by_bit() {
        for days in [0, 1, 9, 400] {
            let parts = ensemble(days).to_parts();
            let bytes = encode(&parts).encode_to_vec();
            let read = decode(&layout::Ensemble::decode(bytes.as_slice()).expect("a message")).expect("valid");
            assert_eq!(read, parts);
            assert_eq!(Ensemble::from_parts(&read).expect("valid").to_parts(), parts);
            assert!(bytes.len() < 24_000, "{} bytes after {days} days", bytes.len());
        }
    }

    #[test]
    fn an_ensemble_with_a_list_of_another_length_is_refused() {
        let whole = encode(&ensemble(9).to_parts());
        assert!(decode(&layout::Ensemble { gaps: vec![1], ..whole.clone() }).is_err());
        assert!(decode(&layout::Ensemble { all: vec![0; 6], ..whole.clone() }).is_err());
        let short = decode(&layout::Ensemble { all: vec![0; 8], ..whole.clone() }).expect("a list of singles");
        assert!(Ensemble::from_parts(&short).is_err());
        let nan = [f32::NAN; 82].iter().flat_map(|number| number.to_le_bytes()).collect();
        let nan = decode(&layout::Ensemble { rotations: nan, ..whole }).expect("a list of singles");
        assert!(Ensemble::from_parts(&nan).is_err());
    }
}
