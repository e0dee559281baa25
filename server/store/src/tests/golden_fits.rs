//! The bytes of format 2: a map with every model enabled, and states with models of every kind. A difference here means
//! that existing data directories cannot be read any more: do not change the files in `golden/`; make a new
//! format.

use std::{
    fs,
    path::{Path, PathBuf},
};

use tidemap_map::{event::StateKind, snapshot::MapSnapshot, spec::MapSpec};
use tidemap_model::{
    Alternatives, EnabledModels, FitKind, FitParts, FittedModelParts, LocalDay,
    models::{
        HypertimeAxis, HypertimeCluster, HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts, HypertimeParts,
        HypertimePeriod, PergamGaussian, PergamParts,
    },
};

use super::{
    example::{append, copy, options},
    golden_states::{self, FILES, alternatives, update},
};
use crate::{MapId, Source, Store, index::tests_only::rows_checksum};

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/golden/format-2-fits")
}

fn spec() -> MapSpec {
    let fits = [FitKind::Calibrated, FitKind::Pergam, FitKind::HypertimeEm, FitKind::HypertimeKm];
    let models = EnabledModels::SPECTRAL.with_histograms(true);
    MapSpec { models: fits.into_iter().fold(models, EnabledModels::with_fit), ..golden_states::spec() }
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
    let of = |weight| match method {
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
        gain: 1.0,
        ones: vec![of(0.75), of(0.25)],
        zeros: vec![of(1.0)],
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

/// The data of a state of that kind, with the models of `fits` and the calibrated one.
fn known(of: StateKind, fits: Vec<(FittedModelParts, Option<f64>)>, choice: u8) -> Alternatives {
    let mut parts = alternatives(Some(Some(2.75))).to_parts();
    let fit = |(model, error_sum)| FitParts { model, day: LocalDay(19_669), error_sum };
    parts.fits.extend(fits.into_iter().map(fit));
    parts.since = Some(LocalDay(19_600));
    parts.choice = choice;
    Alternatives::from_parts_of(of, parts).expect("valid")
}

fn snapshot() -> MapSnapshot {
    let gaussian = |weight, mean_secs| PergamGaussian { weight, mean_secs, deviation_secs: 900.0 };
    let pergam = PergamParts {
        period_nanos: 86_400_000_000_000,
        gaussians: vec![gaussian(0.0625, 32_400.5), gaussian(0.25, 61_200.125)],
    };
    let all = vec![
        (FittedModelParts::Pergam(pergam), Some(1.5)),
        (FittedModelParts::Hypertime(odds(HypertimeMethod::Em)), Some(3.5)),
        (FittedModelParts::Hypertime(odds(HypertimeMethod::Km)), None),
    ];
    let values = [HypertimeMethod::Em, HypertimeMethod::Km].map(|method| {
        let known = known(
            StateKind::Continuous,
            vec![(FittedModelParts::Hypertime(field(method)), Some(0.5))],
            if method == HypertimeMethod::Em { 130 } else { 131 },
        );
        golden_states::state_of(StateKind::Continuous, &format!("warmth {method:?}"), known)
    });
    let mut states = vec![golden_states::state("door", known(StateKind::Probability, all, 129))];
    states.extend(values);
    MapSnapshot { states, ..golden_states::snapshot() }
}

#[test]
fn fitted_models_of_format_2_are_written_as_they_always_were() {
    let directory = tempfile::tempdir().expect("temporary directory");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let map = store.create_map(&spec()).expect("creates");
        let log = store.open_map(map, &spec()).expect("opens").log;
        append(&log, &update()).expect("appends");
        store.save(map, &snapshot()).expect("saves");
    }
    // The manifest names the present format.
    for file in &FILES[1..] {
        let written = fs::read(directory.path().join(file)).expect("readable");
        let is_same = fs::read(golden().join(file)).ok().as_ref() == Some(&written);
        assert!(is_same, "{file} is not written as it was; what is written now is in {}", directory.keep().display());
    }
    assert_eq!(rows_checksum(1, &snapshot()), 0x3738_F800);
}

#[test]
fn fitted_models_of_format_2_are_read_as_they_always_were() {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(&golden(), directory.path());
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.maps(), [(MapId(1), spec())]);
    let opened = store.open_map(MapId(1), &spec()).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (Source::Checkpoint, Some(snapshot())));
}
