//! The models that were fitted to a state's readings, except the calibrated one, as bytes, and back.
//!
//! Invariant: every number is read back bit by bit. The constructors of the models check the numbers.

use prost::Message as _;
use tidemap_migrations::v2::fits as v2;
use tidemap_model::{
    FitParts, FittedModelParts, LocalDay,
    models::{
        HypertimeAxis, HypertimeCluster, HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts, HypertimeParts,
        PergamGaussian, PergamParts,
    },
};

use super::Invalid;

const INVALID: Invalid = "the fitted models of a state are not valid";

/// Empty if there is none.
pub(crate) fn encode(fits: &[FitParts]) -> Vec<u8> {
    let mut message = v2::Fits::default();
    for parts in fits {
        let fit = Some(v2::Fit { day: parts.day.0, error_sum_bits: parts.error_sum.map(f64::to_bits) });
        match &parts.model {
            FittedModelParts::Calibrated(_) => {}
            FittedModelParts::Pergam(model) => message.pergam = Some(encode_pergam(fit, model)),
            FittedModelParts::Hypertime(model) => {
                let (method, model) = encode_hypertime(fit, model);
                match method {
                    HypertimeMethod::Em => message.hypertime_em = Some(model),
                    HypertimeMethod::Km => message.hypertime_km = Some(model),
                }
            }
        }
    }
    message.encode_to_vec()
}

pub(crate) fn decode(bytes: &[u8]) -> Result<Vec<FitParts>, Invalid> {
    let message = v2::Fits::decode(bytes).map_err(|_| INVALID)?;
    let pergam = message.pergam.as_ref().map(decode_pergam);
    let em = message.hypertime_em.as_ref().map(|model| decode_hypertime(HypertimeMethod::Em, model));
    let km = message.hypertime_km.as_ref().map(|model| decode_hypertime(HypertimeMethod::Km, model));
    pergam.into_iter().chain(em).chain(km).collect()
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

fn doubles(bits: &[u64]) -> Vec<f64> {
    bits.iter().map(|&bits| f64::from_bits(bits)).collect()
}

fn with_fit(model: FittedModelParts, fit: Option<&v2::Fit>) -> Result<FitParts, Invalid> {
    let fit = fit.ok_or(INVALID)?;
    Ok(FitParts { model, day: LocalDay(fit.day), error_sum: fit.error_sum_bits.map(f64::from_bits) })
}

fn encode_pergam(fit: Option<v2::Fit>, model: &PergamParts) -> v2::Pergam {
    let numbers = |gaussian: &PergamGaussian| [gaussian.weight, gaussian.mean_secs, gaussian.deviation_secs];
    let gaussians: Vec<f64> = model.gaussians.iter().flat_map(numbers).collect();
    v2::Pergam { fit, period_nanos: model.period_nanos, gaussians_bits: bits(&gaussians) }
}

fn decode_pergam(message: &v2::Pergam) -> Result<FitParts, Invalid> {
    let numbers = doubles(&message.gaussians_bits);
    let (gaussians, []) = numbers.as_chunks::<3>() else { return Err(INVALID) };
    let gaussian =
        |&[weight, mean_secs, deviation_secs]: &[f64; 3]| PergamGaussian { weight, mean_secs, deviation_secs };
    let gaussians = gaussians.iter().map(gaussian).collect();
    let model = PergamParts { period_nanos: message.period_nanos, gaussians };
    with_fit(FittedModelParts::Pergam(model), message.fit.as_ref())
}

fn encode_hypertime(fit: Option<v2::Fit>, model: &HypertimeParts) -> (HypertimeMethod, v2::Hypertime) {
    let clusters = |clusters: &[HypertimeCluster]| clusters.iter().map(encode_cluster).collect();
    match model {
        HypertimeParts::Probability(odds) => {
            let message = v2::Hypertime {
                fit,
                week_divisors: odds.week_divisors.clone(),
                odds_bits: bits(&[odds.mean, odds.background, odds.log_ones, odds.log_zeros]),
                axis_bits: Vec::new(),
                clusters: clusters(&odds.ones),
                zeros: clusters(&odds.zeros),
                gain_bits: Some(odds.gain.to_bits()).filter(|&bits| bits != 1.0_f64.to_bits()),
            };
            (odds.method, message)
        }
        HypertimeParts::Continuous(field) => {
            // A model of the value only, without a location.
            let axes = field.value.iter().flat_map(|axis| [axis.centre, axis.scale, axis.low, axis.high]);
            let message = v2::Hypertime {
                fit,
                week_divisors: field.week_divisors.clone(),
                odds_bits: Vec::new(),
                axis_bits: bits(&axes.collect::<Vec<f64>>()),
                clusters: clusters(&field.clusters),
                zeros: Vec::new(),
                gain_bits: None,
            };
            (field.method, message)
        }
    }
}

fn decode_hypertime(method: HypertimeMethod, message: &v2::Hypertime) -> Result<FitParts, Invalid> {
    let clusters = |clusters: &[v2::Cluster]| clusters.iter().map(decode_cluster).collect();
    let week_divisors = message.week_divisors.clone();
    let model = match (doubles(&message.odds_bits).as_slice(), doubles(&message.axis_bits).as_slice()) {
        (&[mean, background, log_ones, log_zeros], []) => HypertimeParts::Probability(HypertimeOddsParts {
            method,
            week_divisors,
            mean,
            background,
            log_ones,
            log_zeros,
            gain: message.gain_bits.map_or(1.0, f64::from_bits),
            ones: clusters(&message.clusters),
            zeros: clusters(&message.zeros),
        }),
        ([], &[centre, scale, low, high]) => HypertimeParts::Continuous(HypertimeFieldParts {
            method,
            week_divisors,
            location: Vec::new(),
            value: vec![HypertimeAxis { centre, scale, low, high }],
            clusters: clusters(&message.clusters),
        }),
        _ => return Err(INVALID),
    };
    with_fit(FittedModelParts::Hypertime(model), message.fit.as_ref())
}

fn encode_cluster(cluster: &HypertimeCluster) -> v2::Cluster {
    v2::Cluster {
        weight_bits: cluster.weight.to_bits(),
        centre_bits: bits(&cluster.centre),
        factor_bits: bits(&cluster.factor),
        directions_bits: bits(&cluster.directions_rad),
        concentrations_bits: bits(&cluster.concentrations),
    }
}

fn decode_cluster(message: &v2::Cluster) -> HypertimeCluster {
    HypertimeCluster {
        weight: f64::from_bits(message.weight_bits),
        centre: doubles(&message.centre_bits),
        factor: doubles(&message.factor_bits),
        directions_rad: doubles(&message.directions_bits),
        concentrations: doubles(&message.concentrations_bits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_read_back_and_is_one_where_a_record_has_none() {
        let fit = |gain| FitParts {
            model: FittedModelParts::Hypertime(HypertimeParts::Probability(HypertimeOddsParts {
                method: HypertimeMethod::Em,
                week_divisors: vec![7],
                mean: 0.25,
                background: 1.0,
                log_ones: 0.5,
                log_zeros: 1.5,
                gain,
                ones: Vec::new(),
                zeros: Vec::new(),
            })),
            day: LocalDay(1),
            error_sum: None,
        };
        for gain in [0.75, 1.0, 1.25] {
            assert_eq!(decode(&encode(&[fit(gain)])), Ok(vec![fit(gain)]));
        }
        let mut message = v2::Fits::decode(encode(&[fit(0.75)]).as_slice()).expect("a record");
        message.hypertime_em.as_mut().expect("the model").gain_bits = None;
        assert_eq!(decode(&message.encode_to_vec()), Ok(vec![fit(1.0)]));
    }
}
