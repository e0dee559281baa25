//! Errors of the predictions of the door, and the learned model.

use super::Door;

const TOLERANCE: f64 = 0.0002;
const ORDERS: [usize; 7] = [0, 1, 2, 3, 5, 10, 15];
const FILES: [(&str, f64, [f64; 7]); 5] = [
    ("train.csv", 96_480.0, [0.10418, 0.08797, 0.08290, 0.07886, 0.07336, 0.06623, 0.06262]),
    ("week1.csv", 10_020.0, [0.09041, 0.07968, 0.07317, 0.06892, 0.06864, 0.06652, 0.06502]),
    ("week2.csv", 10_080.0, [0.07722, 0.07048, 0.06826, 0.06614, 0.06961, 0.07333, 0.07124]),
    ("week3.csv", 10_080.0, [0.08351, 0.07580, 0.07506, 0.07378, 0.07327, 0.07059, 0.06866]),
    ("week4.csv", 8_640.0, [0.09121, 0.08078, 0.07304, 0.06750, 0.06325, 0.05400, 0.05212]),
];
const COMPONENTS: [(f64, f64); 5] =
    [(86_400.0, 0.1773), (604_800.0, 0.0898), (21_600.0, 0.0808), (302_400.0, 0.0764), (75_600.0, 0.0682)];

#[track_caller]
fn near(what: &str, found: f64, expected: f64) {
    assert!((found - expected).abs() <= TOLERANCE, "{what}: {found:.5}, expected {expected:.5}");
}

/// Mean squared errors by order, and the number of observations compared.
fn errors(door: &Door, file: &str, more: &[&str]) -> (Vec<f64>, Vec<f64>) {
    let path = door.file(file);
    let args = ["evaluate", "door", path.to_str().expect("a path that is text")];
    let table = door.tidemap(args.into_iter().chain(more.iter().copied())).table();
    assert_eq!(table.columns, ["state", "model", "order", "n", "mse", "error_rate"]);
    assert!(table.column("state").iter().all(|&state| state == "door"));
    assert!(table.column("model").iter().all(|&model| model == "spectral"));
    let orders: Vec<usize> = table.column("order").iter().map(|order| order.parse().expect("an order")).collect();
    assert_eq!(orders, (0..orders.len()).collect::<Vec<_>>());
    (table.numbers("mse"), table.numbers("n"))
}

#[test]
fn the_door_is_predicted_as_well_as_by_the_reference() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    for (file, observations, expected) in FILES {
        let (found, n) = errors(&door, file, &[]);
        assert_eq!(n, vec![observations; 16], "{file}");
        for (order, expected) in ORDERS.into_iter().zip(expected) {
            near(&format!("{file}, order {order}"), found[order], expected);
        }
    }
    let (some, _) = errors(&door, "week1.csv", &["--max-order", "3"]);
    assert_eq!(some.len(), 4);

    let model = door.tidemap(["model", "show", "door", "door"]).table();
    assert!(model.column("n").iter().all(|&n| n == "96480"));
    assert_eq!(model.rows.len(), 15);
    near("the mean", model.numbers("mean")[0], 0.118);
    let (periods, amplitudes) = (model.numbers("period_secs"), model.numbers("amplitude"));
    for ((period, amplitude), expected) in periods.iter().zip(&amplitudes).zip(COMPONENTS) {
        assert!((period - expected.0).abs() < 1e-6, "{period}, expected {}", expected.0);
        near(&format!("amplitude of {period} s"), *amplitude, expected.1);
    }
    assert!(amplitudes.is_sorted_by(|a, b| a >= b), "strongest first: {amplitudes:?}");
    // The evaluated observations have not been learned.
    assert_eq!(door.tidemap(["map", "show", "door"]).table().number("observations"), 96_480.0);
}

#[test]
fn a_map_in_utc_misses_the_change_to_summer_time() {
    let Some(door) = Door::new("UTC") else { return };
    door.learn();
    for (file, expected) in [("week2.csv", 0.06884), ("week3.csv", 0.07562), ("week4.csv", 0.07402)] {
        near(file, errors(&door, file, &["--max-order", "2"]).0[2], expected);
    }
}

#[test]
fn other_models_are_evaluated_beside_the_spectral_one() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    let path = door.file("week1.csv");
    let models = ["--models", "mean,latest,spectral,spectral+persistence", "--max-order", "2"];
    let args = ["evaluate", "door", path.to_str().expect("a path that is text")];
    let table = door.tidemap(args.into_iter().chain(models)).table();
    let expected = [
        ["mean", ""],
        ["latest", ""],
        ["spectral", "0"],
        ["spectral", "1"],
        ["spectral", "2"],
        ["spectral+persistence", "0"],
        ["spectral+persistence", "1"],
        ["spectral+persistence", "2"],
    ];
    let found: Vec<[&str; 2]> = table.column("model").into_iter().zip(table.column("order")).map(Into::into).collect();
    assert_eq!(found, expected);
    let (errors, rates) = (table.numbers("mse"), table.numbers("error_rate"));
    near("the mean is order 0", errors[0], FILES[1].2[0]);
    assert_eq!(errors[0], errors[2]);
    // The last value is 0, so its error is the share of ones: the mean of a week of minutes.
    let ones: f64 = tidemap_tests::recordings::rows(&path).iter().map(|&(_, value)| value).sum();
    near("the last value", errors[1], ones / FILES[1].1);
    near("its share of wrong ones", rates[1], ones / FILES[1].1);
}
