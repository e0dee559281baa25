//! The unusual observations of a state as a message, and back.
//!
//! Invariant: every number is read back bit by bit; numbers outside their range are refused.

use tidemap_layout::map as layout;
use tidemap_model::{SurpriseRun, Surprises};

/// The message; `None` if there is nothing to keep.
pub(crate) fn encode(surprises: &Surprises) -> Option<layout::Surprises> {
    if *surprises == Surprises::default() {
        return None;
    }
    let run = |run: &SurpriseRun| {
        let (probability_bits, observed_bits) = (run.probability.to_bits(), run.observed_probability.to_bits());
        layout::SurpriseRun {
            first_nanos: run.first_nanos,
            length_nanos: run.last_nanos.abs_diff(run.first_nanos),
            observations: run.observations,
            is_above: run.is_above,
            value_bits: run.value.to_bits(),
            probability_bits,
            observed_bits: (observed_bits != probability_bits).then_some(observed_bits),
            surprise_bits: run.bits.to_bits(),
        }
    };
    let runs = surprises.runs().iter().map(run).collect();
    Some(layout::Surprises { runs, is_open: surprises.is_open(), dropped: surprises.dropped() })
}

/// The unusual observations of a message; none if it is absent.
pub(crate) fn decode(message: Option<&layout::Surprises>) -> Result<Surprises, String> {
    let Some(message) = message else { return Ok(Surprises::default()) };
    let run = |run: &layout::SurpriseRun| {
        let last_nanos = run.first_nanos.checked_add_unsigned(run.length_nanos);
        Ok(SurpriseRun {
            first_nanos: run.first_nanos,
            last_nanos: last_nanos.ok_or("a run of unusual observations ends after all time")?,
            observations: run.observations,
            is_above: run.is_above,
            value: f64::from_bits(run.value_bits),
            probability: f64::from_bits(run.probability_bits),
            observed_probability: f64::from_bits(run.observed_bits.unwrap_or(run.probability_bits)),
            bits: f64::from_bits(run.surprise_bits),
        })
    };
    let runs = message.runs.iter().map(run).collect::<Result<Vec<_>, String>>()?;
    Surprises::from_parts(runs, message.is_open, message.dropped).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    fn surprises() -> Surprises {
        let run = SurpriseRun {
            first_nanos: 1_700_000_000_123_456_789,
            last_nanos: 1_700_151_200_123_456_789,
            observations: 254,
            is_above: true,
            value: 1.0,
            probability: 0.0078125,
            observed_probability: 0.0078125,
            bits: 402.5,
        };
        let closed = SurpriseRun { is_above: false, value: 0.25, observed_probability: 0.9921875, ..run };
        Surprises::from_parts(vec![run, closed], true, 7).expect("valid")
    }

    #[test]
    fn the_bytes_of_what_was_unusual_stay_as_they_are() {
        let message = encode(&surprises()).expect("a message");
        let bytes: String = message.encode_to_vec().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(bytes, GOLDEN, "data folders have these bytes: do not change them");
        assert_eq!(decode(Some(&message)), Ok(surprises()));
    }

    const GOLDEN: &str = "0a310915cd853dfe9c9717108080a9f2bfb02218fe01200129000000000000f03f31000000000000803f41000000000\
        02879400a380915cd853dfe9c9717108080a9f2bfb02218fe0129000000000000d03f31000000000000803f390000000000c0ef3f410000\
        00000028794010011807";

    #[test]
    fn nothing_unusual_takes_no_room() {
        assert_eq!(encode(&Surprises::default()), None);
        assert_eq!(decode(None), Ok(Surprises::default()));
    }

    #[test]
    fn what_no_model_can_have_found_is_refused() {
        let wrong = |change: fn(&mut layout::SurpriseRun)| {
            let mut message = encode(&surprises()).expect("a message");
            change(&mut message.runs[0]);
            decode(Some(&message)).expect_err("refused")
        };
        assert!(wrong(|run| run.length_nanos = u64::MAX).contains("after all time"));
        wrong(|run| run.probability_bits = 2.0_f64.to_bits());
        wrong(|run| run.value_bits = f64::NAN.to_bits());
        wrong(|run| run.first_nanos += 1);
    }
}
