//! Errors of the predictions of the door, and the learned model.

use super::Door;

#[path = "../../../server/model/tests/recordings/door_figures.rs"]
mod door_figures;
use door_figures::{COMPONENTS, ERRORS, ORDERS, TOLERANCE};

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
    for (file, observations, expected) in ERRORS {
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
    near("the mean is order 0", errors[0], ERRORS[1].2[0]);
    assert_eq!(errors[0], errors[2]);
    // The last value is 0, so its error is the share of ones: the mean of a week of minutes.
    let ones: f64 = tidemap_tests::recordings::rows(&path).iter().map(|&(_, value)| value).sum();
    near("the last value", errors[1], ones / ERRORS[1].1);
    near("its share of wrong ones", rates[1], ones / ERRORS[1].1);
}
