//! The map of `golden.rs` with every model enabled, and with states that have models of every kind.

use tidemap_map::{event::StateKind, name::MapName, snapshot::MapSnapshot, spec::MapSpec};
use tidemap_model::{
    Alternatives, Component, EnabledModels, LocalDay, TrainedModelParts, TrainingRecordParts,
    models::{
        CountRateParts, HypertimeAxis, HypertimeCluster, HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts,
        HypertimeParts, HypertimePeriod, PergamGaussian, PergamParts, PoissonSpectralParts,
    },
};

use super::{
    golden::Golden,
    golden_states::{self, alternatives, update},
};

fn spec() -> MapSpec {
    let name = MapName::new("museum").expect("valid");
    MapSpec { name, models: EnabledModels::ALL.without_ensemble(), ..golden_states::spec() }
}

/// A cluster with the given numbers of coordinates and circles.
fn cluster(coordinates: usize, circles: usize, weight: f64) -> HypertimeCluster {
    let factor = (0..coordinates).flat_map(|i| (0..=i).map(move |j| if i == j { 0.5 } else { -0.125 })).collect();
    HypertimeCluster {
        weight,
        centre: (0..coordinates).map(|i| 0.25 * i as f64).collect(),
        factor,
        directions_rad: (0..circles).map(|i| 1.5 - i as f64).collect(),
        concentrations: (0..circles).map(|i| 2.0 + i as f64).collect(),
    }
}

fn odds(method: HypertimeMethod) -> HypertimeParts {
    let weighted = |weight| match method {
        HypertimeMethod::Em => cluster(4, 0, weight),
        HypertimeMethod::Km => cluster(0, 2, weight),
    };
    HypertimeParts::Probability(HypertimeOddsParts {
        method,
        periods: [7, 1].map(|divisor| HypertimePeriod { cycle_nanos: 604_800_000_000_000, divisor }).to_vec(),
        mean: 0.375,
        background: 60.0,
        log_ones: 2.5,
        log_zeros: 3.25,
        gain: 1.25,
        ones: vec![weighted(0.75), weighted(0.25)],
        zeros: vec![weighted(1.0)],
    })
}

fn field(method: HypertimeMethod) -> HypertimeParts {
    HypertimeParts::Continuous(HypertimeFieldParts {
        method,
        periods: vec![HypertimePeriod { cycle_nanos: 604_800_000_000_000, divisor: 7 }],
        location: Vec::new(),
        value: vec![HypertimeAxis { centre: 20.5, scale: 1.5, low: 17.25, high: 26.0 }],
        clusters: vec![match method {
            HypertimeMethod::Em => cluster(3, 0, 1.0),
            HypertimeMethod::Km => cluster(1, 1, 1.0),
        }],
    })
}

/// The learned data of a state of a kind, with the models of `models` and the calibrated one.
fn known(state_kind: StateKind, models: Vec<(TrainedModelParts, Option<f64>)>, choice: u8) -> Alternatives {
    let mut parts = alternatives(Some(Some(2.75))).to_parts();
    let record = |(model, error_sum)| TrainingRecordParts { model, day: LocalDay(19_669), error_sum };
    parts.trained.extend(models.into_iter().map(record));
    parts.since = Some(LocalDay(19_600));
    parts.choice = choice;
    Alternatives::from_parts_of(state_kind, parts).expect("valid")
}

pub(super) fn snapshot() -> MapSnapshot {
    let gaussian = |weight, mean_secs| PergamGaussian { weight, mean_secs, deviation_secs: 900.0 };
    let pergam = PergamParts {
        period_nanos: 86_400_000_000_000,
        gaussians: vec![gaussian(0.0625, 32_400.5), gaussian(0.25, 61_200.125)],
    };
    let all = vec![
        (TrainedModelParts::Pergam(pergam), Some(1.5)),
        (TrainedModelParts::Hypertime(odds(HypertimeMethod::Em)), Some(3.5)),
        (TrainedModelParts::Hypertime(odds(HypertimeMethod::Km)), None),
    ];
    let values = [HypertimeMethod::Em, HypertimeMethod::Km].map(|method| {
        let known = known(
            StateKind::Continuous,
            vec![(TrainedModelParts::Hypertime(field(method)), Some(0.5))],
            if method == HypertimeMethod::Em { 130 } else { 131 },
        );
        golden_states::state_of(StateKind::Continuous, &format!("warmth {method:?}"), known)
    });
    let rate = CountRateParts {
        periodicities: golden_states::spec().periodicities,
        bins: PoissonSpectralParts {
            bin_nanos: 3_600_000_000_000,
            mean: 4.5,
            floor: 0.25,
            components: vec![Component { periodicity: 1, gamma_re: 0.5, gamma_im: -0.125 }],
        },
        readings_per_bin: 6.0,
    };
    let counts = known(StateKind::Count, vec![(TrainedModelParts::Poisson(rate), Some(1.25))], 132);
    let mut states = vec![golden_states::state("door", known(StateKind::Probability, all, 129))];
    states.extend(values);
    states.push(golden_states::state_of(StateKind::Count, "people", counts));
    // An erasure computes this time from the last values of the states that are left, and these have none.
    MapSnapshot { states, newest_nanos: 0, ..golden_states::snapshot() }
}

/// The snapshot with a further state, which is erased after it was saved; `None` for another map.
pub(super) fn erased(snapshot: &MapSnapshot) -> Option<MapSnapshot> {
    if *snapshot != self::snapshot() {
        return None;
    }
    let mut more = snapshot.clone();
    more.states.push(golden_states::state("visitor", alternatives(None)));
    Some(more)
}

pub(super) fn map() -> Golden {
    Golden { spec: spec(), events: vec![update()], snapshot: snapshot(), rows: 0xC9B0_1794 }
}
