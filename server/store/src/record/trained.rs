//! The models that were trained on a state's readings, except the calibrated model, as bytes, and back.
//!
//! Invariant: every number is read back bit by bit. The constructors of the models check the numbers.

use prost::Message as _;
use tidemap_layout::trained as layout;
use tidemap_model::{
    Component, LocalDay, Periodicities, TrainedModelParts, TrainingRecordParts,
    models::{
        CountRateParts, HypertimeAxis, HypertimeCluster, HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts,
        HypertimeParts, HypertimePeriod, PergamGaussian, PergamParts, PoissonSpectralParts,
    },
};

use super::Invalid;

const INVALID: Invalid = "the trained models of a state are not valid";

/// Encodes the models; empty if there is none.
pub(crate) fn encode(records: &[TrainingRecordParts]) -> Vec<u8> {
    let mut message = layout::TrainedModels::default();
    for parts in records {
        let training = Some(layout::Training { day: parts.day.0, error_sum_bits: parts.error_sum.map(f64::to_bits) });
        match &parts.model {
            TrainedModelParts::Calibrated(_) => {}
            TrainedModelParts::Poisson(model) => message.poisson = Some(encode_poisson(training, model)),
            TrainedModelParts::Pergam(model) => message.pergam = Some(encode_pergam(training, model)),
            TrainedModelParts::Hypertime(model) => {
                let (method, model) = encode_hypertime(training, model);
                match method {
                    HypertimeMethod::Em => message.hypertime_em = Some(model),
                    HypertimeMethod::Km => message.hypertime_km = Some(model),
                }
            }
        }
    }
    message.encode_to_vec()
}

/// Decodes the models of a state of a map with these periodicities.
pub(crate) fn decode(bytes: &[u8], periodicities: &Periodicities) -> Result<Vec<TrainingRecordParts>, Invalid> {
    let message = layout::TrainedModels::decode(bytes).map_err(|_| INVALID)?;
    let pergam = message.pergam.as_ref().map(decode_pergam);
    let em = message.hypertime_em.as_ref().map(|model| decode_hypertime(HypertimeMethod::Em, model));
    let km = message.hypertime_km.as_ref().map(|model| decode_hypertime(HypertimeMethod::Km, model));
    let poisson = message.poisson.as_ref().map(|model| decode_poisson(model, periodicities));
    pergam.into_iter().chain(em).chain(km).chain(poisson).collect()
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

fn doubles(bits: &[u64]) -> Vec<f64> {
    bits.iter().map(|&bits| f64::from_bits(bits)).collect()
}

fn with_training(
    model: TrainedModelParts,
    training: Option<&layout::Training>,
) -> Result<TrainingRecordParts, Invalid> {
    let training = training.ok_or(INVALID)?;
    Ok(TrainingRecordParts {
        model,
        day: LocalDay(training.day),
        error_sum: training.error_sum_bits.map(f64::from_bits),
    })
}

fn encode_pergam(training: Option<layout::Training>, model: &PergamParts) -> layout::Pergam {
    let numbers = |gaussian: &PergamGaussian| [gaussian.weight, gaussian.mean_secs, gaussian.deviation_secs];
    let gaussians: Vec<f64> = model.gaussians.iter().flat_map(numbers).collect();
    layout::Pergam { training, period_nanos: model.period_nanos, gaussians_bits: bits(&gaussians) }
}

fn decode_pergam(message: &layout::Pergam) -> Result<TrainingRecordParts, Invalid> {
    let numbers = doubles(&message.gaussians_bits);
    let (gaussians, []) = numbers.as_chunks::<3>() else { return Err(INVALID) };
    let gaussian =
        |&[weight, mean_secs, deviation_secs]: &[f64; 3]| PergamGaussian { weight, mean_secs, deviation_secs };
    let gaussians = gaussians.iter().map(gaussian).collect();
    let model = PergamParts { period_nanos: message.period_nanos, gaussians };
    with_training(TrainedModelParts::Pergam(model), message.training.as_ref())
}

fn encode_poisson(training: Option<layout::Training>, model: &CountRateParts) -> layout::Poisson {
    let CountRateParts { bins, readings_per_bin, .. } = model;
    let gammas: Vec<f64> = bins.components.iter().flat_map(|one| [one.gamma_re, one.gamma_im]).collect();
    layout::Poisson {
        training,
        bin_nanos: bins.bin_nanos,
        rate_bits: bits(&[bins.mean, bins.floor, *readings_per_bin]),
        periodicities: bins.components.iter().map(|one| one.periodicity).collect(),
        gammas_bits: bits(&gammas),
    }
}

fn decode_poisson(message: &layout::Poisson, periodicities: &Periodicities) -> Result<TrainingRecordParts, Invalid> {
    let &[mean, floor, readings_per_bin] = doubles(&message.rate_bits).as_slice() else { return Err(INVALID) };
    let gammas = doubles(&message.gammas_bits);
    let (gammas, []) = gammas.as_chunks::<2>() else { return Err(INVALID) };
    if gammas.len() != message.periodicities.len() {
        return Err(INVALID);
    }
    let component =
        |(&periodicity, &[gamma_re, gamma_im]): (&u32, &[f64; 2])| Component { periodicity, gamma_re, gamma_im };
    let components = message.periodicities.iter().zip(gammas).map(component).collect();
    let bins = PoissonSpectralParts { bin_nanos: message.bin_nanos, mean, floor, components };
    let model = CountRateParts { periodicities: periodicities.clone(), bins, readings_per_bin };
    with_training(TrainedModelParts::Poisson(model), message.training.as_ref())
}

fn encode_hypertime(
    training: Option<layout::Training>,
    model: &HypertimeParts,
) -> (HypertimeMethod, layout::Hypertime) {
    let clusters = |clusters: &[HypertimeCluster]| clusters.iter().map(encode_cluster).collect();
    match model {
        HypertimeParts::Probability(odds) => {
            let message = layout::Hypertime {
                training,
                divisors: divisors(&odds.periods),
                cycle_nanos: cycles(&odds.periods),
                odds_bits: bits(&[odds.mean, odds.background, odds.log_ones, odds.log_zeros]),
                axis_bits: Vec::new(),
                clusters: clusters(&odds.ones),
                zeros: clusters(&odds.zeros),
                gain_bits: odds.gain.to_bits(),
            };
            (odds.method, message)
        }
        HypertimeParts::Continuous(field) => {
            // This is a model of the value only, without a location.
            let axes = field.value.iter().flat_map(|axis| [axis.centre, axis.scale, axis.low, axis.high]);
            let message = layout::Hypertime {
                training,
                divisors: divisors(&field.periods),
                cycle_nanos: cycles(&field.periods),
                odds_bits: Vec::new(),
                axis_bits: bits(&axes.collect::<Vec<f64>>()),
                clusters: clusters(&field.clusters),
                zeros: Vec::new(),
                gain_bits: 0,
            };
            (field.method, message)
        }
    }
}

fn decode_hypertime(method: HypertimeMethod, message: &layout::Hypertime) -> Result<TrainingRecordParts, Invalid> {
    let clusters = |clusters: &[layout::Cluster]| clusters.iter().map(decode_cluster).collect();
    let periods = periods(&message.divisors, &message.cycle_nanos)?;
    let model = match (doubles(&message.odds_bits).as_slice(), doubles(&message.axis_bits).as_slice()) {
        (&[mean, background, log_ones, log_zeros], []) => HypertimeParts::Probability(HypertimeOddsParts {
            method,
            periods,
            mean,
            background,
            log_ones,
            log_zeros,
            gain: f64::from_bits(message.gain_bits),
            ones: clusters(&message.clusters),
            zeros: clusters(&message.zeros),
        }),
        ([], &[centre, scale, low, high]) => HypertimeParts::Continuous(HypertimeFieldParts {
            method,
            periods,
            location: Vec::new(),
            value: vec![HypertimeAxis { centre, scale, low, high }],
            clusters: clusters(&message.clusters),
        }),
        _ => return Err(INVALID),
    };
    with_training(TrainedModelParts::Hypertime(model), message.training.as_ref())
}

fn divisors(periods: &[HypertimePeriod]) -> Vec<u32> {
    periods.iter().map(|period| period.divisor).collect()
}

fn cycles(periods: &[HypertimePeriod]) -> Vec<i64> {
    periods.iter().map(|period| period.cycle_nanos).collect()
}

fn periods(divisors: &[u32], cycles: &[i64]) -> Result<Vec<HypertimePeriod>, Invalid> {
    if cycles.len() != divisors.len() {
        return Err(INVALID);
    }
    let period = |(&divisor, &cycle_nanos): (&u32, &i64)| HypertimePeriod { cycle_nanos, divisor };
    Ok(divisors.iter().zip(cycles).map(period).collect())
}

fn encode_cluster(cluster: &HypertimeCluster) -> layout::Cluster {
    layout::Cluster {
        weight_bits: cluster.weight.to_bits(),
        centre_bits: bits(&cluster.centre),
        factor_bits: bits(&cluster.factor),
        directions_bits: bits(&cluster.directions_rad),
        concentrations_bits: bits(&cluster.concentrations),
    }
}

fn decode_cluster(message: &layout::Cluster) -> HypertimeCluster {
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
    use tidemap_model::{
        Sample,
        models::{CountRate, Readings},
    };

    use super::*;

    #[test]
    fn the_rate_of_counts_reads_back_as_it_was() {
        let sample = |slot: i64| Sample {
            utc_nanos: slot * 1_200_000_000_000,
            offset_secs: 3600,
            value: f64::from(u8::from(slot % 72 > 20)) * (slot % 5) as f64,
        };
        let samples: Vec<Sample> = (0..720).map(sample).collect();
        let periodicities = Periodicities::default();
        let model = CountRate::train(Readings::new(&samples), &periodicities).expect("counts").to_parts();
        assert!(!model.bins.components.is_empty());
        let records =
            [TrainingRecordParts { model: TrainedModelParts::Poisson(model), day: LocalDay(9), error_sum: Some(0.1) }];
        assert_eq!(decode(&encode(&records), &periodicities), Ok(records.to_vec()));
        let mut message = layout::TrainedModels::decode(encode(&records).as_slice()).expect("a message");
        message.poisson.as_mut().expect("it is there").gammas_bits.pop();
        assert_eq!(decode(&message.encode_to_vec(), &periodicities), Err(INVALID));
    }

    fn hypertime(gain: f64, periods: &[HypertimePeriod]) -> TrainingRecordParts {
        TrainingRecordParts {
            model: TrainedModelParts::Hypertime(HypertimeParts::Probability(HypertimeOddsParts {
                method: HypertimeMethod::Em,
                periods: periods.to_vec(),
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
        }
    }

    fn stored(record: &TrainingRecordParts) -> layout::Hypertime {
        let message = layout::TrainedModels::decode(encode(std::slice::from_ref(record)).as_slice()).expect("a record");
        message.hypertime_em.expect("the model")
    }

    fn read(model: layout::Hypertime) -> Result<Vec<TrainingRecordParts>, Invalid> {
        let message = layout::TrainedModels { hypertime_em: Some(model), ..layout::TrainedModels::default() };
        decode(&message.encode_to_vec(), &Periodicities::default())
    }

    const WEEK_NANOS: i64 = 7 * 86_400_000_000_000;
    const DAY: HypertimePeriod = HypertimePeriod { cycle_nanos: WEEK_NANOS, divisor: 7 };
    const YEAR: HypertimePeriod = HypertimePeriod { cycle_nanos: 31_556_952_000_000_000, divisor: 1 };

    #[test]
    fn the_gain_is_read_back() {
        for gain in [0.75, 1.0, 1.25] {
            assert_eq!(read(stored(&hypertime(gain, &[DAY]))), Ok(vec![hypertime(gain, &[DAY])]));
        }
    }

    #[test]
    fn periods_are_read_back_and_each_must_have_its_cycle() {
        for periods in [&[DAY][..], &[DAY, YEAR], &[]] {
            assert_eq!(read(stored(&hypertime(1.5, periods))), Ok(vec![hypertime(1.5, periods)]));
        }
        let both = stored(&hypertime(1.5, &[DAY, YEAR]));
        assert_eq!(read(layout::Hypertime { cycle_nanos: vec![WEEK_NANOS], ..both }), Err(INVALID));
    }
}
