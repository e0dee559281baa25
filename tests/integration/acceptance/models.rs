//! The other models, trained on request, on the recording of a real door and on states without enough data
//! to train them. The expected figures come from an independent implementation.

use tidemap_tests::cli;

use super::Door;

const WEEKS: [&str; 4] = ["week1.csv", "week2.csv", "week3.csv", "week4.csv"];

/// Mean errors of the four weeks, by the model and its order as they are printed.
fn errors_of(door: &Door, models: &str) -> Vec<(String, f64)> {
    let mut sums: Vec<(String, f64)> = Vec::new();
    for week in WEEKS {
        let path = door.file(week);
        let args = ["evaluate", "door", path.to_str().expect("a path that is text"), "--models", models];
        let table = door.tidemap(args).table();
        let names = table.column("model").into_iter().zip(table.column("order"));
        let names: Vec<String> = names.map(|(model, order)| format!("{model} {order}").trim_end().to_owned()).collect();
        if sums.is_empty() {
            sums = names.iter().map(|name| (name.clone(), 0.0)).collect();
        }
        assert!(sums.iter().map(|(name, _)| name).eq(&names), "{names:?}");
        for ((_, sum), error) in sums.iter_mut().zip(table.numbers("mse")) {
            *sum += error / WEEKS.len() as f64;
        }
    }
    sums
}

#[test]
fn models_of_the_literature_predict_the_door_as_well_as_the_reference() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    let found = errors_of(&door, "mean,histogram:24,spectral,pergam:5,calibrated,histogram:week,histogram");
    let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
    let orders: Vec<String> = (0..=15).map(|order| format!("spectral {order}")).collect();
    let mut expected = vec!["mean", "histogram:24"];
    expected.extend(orders.iter().map(String::as_str));
    // Omitted parameters get their defaults, and a model that is named twice is compared once.
    expected.extend(["pergam:5", "calibrated", "histogram:week:168"]);
    assert_eq!(names, expected);
    let error = |wanted: &str| {
        let (_, error) = found.iter().find(|(name, _)| name == wanted).expect("it was compared");
        println!("{wanted}: {error:.5}");
        *error
    };
    for (name, expected) in
        [("mean", 0.0856), ("histogram:24", 0.0727), ("spectral 3", 0.0691), ("spectral 15", 0.0643)]
    {
        assert!((error(name) - expected).abs() <= 0.0005, "{name}: {}, expected {expected}", error(name));
    }
    assert!(error("pergam:5") < error("histogram:24"));
    assert!(error("calibrated") < error("spectral 15"));

    // Pending observations are not learned, so they test the models on unseen data.
    let week = door.file("week1.csv");
    assert_eq!(door.observe(&week, &["--label", "later"]).table().number("accepted"), 10_020.0);
    let again = errors_of(&door, "histogram:24,pergam:5,calibrated");
    for (name, found) in again {
        assert_eq!(found, error(&name), "{name}");
    }
    door.tidemap(["update", "door"]).table();
    for (name, found) in errors_of(&door, "histogram:24,calibrated") {
        assert!(found != error(&name), "{name}");
    }
}

#[test]
fn night_by_night_the_calibrated_model_proves_itself_and_answers() {
    let Some(door) = Door::new("Europe/London") else { return };
    assert_eq!(door.observe(&door.file("train.csv"), &["--nightly"]).table().number("accepted"), 96_480.0);
    door.tidemap(["update", "door"]).table();
    let shown = door.tidemap(["--output", "json", "model", "show", "door", "door"]).stdout;
    let (summary, errors) = shown.split_once("\"model_errors\":").expect("errors of what is tried");
    assert!(summary.contains("\"model\":\"calibrated\""), "{shown}");
    for model in ["spectral", "histogram:24", "histogram:weekend:24", "histogram:week:168", "calibrated"] {
        assert_eq!(errors.matches(&format!("\"model\":\"{model}\"")).count(), 1, "{model}: {shown}");
    }
    let found = errors_of(&door, "auto,spectral,calibrated");
    let (_, auto) = found.iter().find(|(name, _)| name.starts_with("auto")).expect("it was compared");
    println!("auto: {auto:.5}");
    assert!(*auto <= 0.0650, "{auto:.5}");
}

/// A door that is open during the first half of each hour, every ten minutes for some days.
fn observe(door: &Door, map: &str, states: &[&str]) {
    let row = |i: i64, state: &str| format!("{},{state},{}\n", 1_451_865_600 + 600 * i, u8::from(i % 6 < 3));
    let rows: String = (0..1000).flat_map(|i| states.iter().map(move |state| row(i, state))).collect();
    let sent = cli::tidemap_reading(&door.daemon, ["observe", map, "-"], &format!("time,state,value\n{rows}"));
    assert_eq!(sent.table().number("refused"), 0.0);
    door.tidemap(["update", map]).table();
}

fn evaluate(door: &Door, map: &str, states: &[&str], models: &str) -> cli::Outcome {
    let rows: String = states.iter().map(|state| format!("1460000000,{state},1\n")).collect();
    let args = ["evaluate", map, "-", "--models", models];
    cli::tidemap_reading(&door.daemon, args, &format!("time,state,value\n{rows}"))
}

#[test]
fn a_model_that_is_not_there_is_left_out_with_a_notice() {
    let Some(door) = Door::new("Europe/London") else { return };
    let states = ["a", "b", "c", "d", "e", "f", "g"];
    observe(&door, "door", &states);
    let all = evaluate(&door, "door", &states, "all");
    let table = all.table();
    let count_of = |wanted: &str| table.column("model").into_iter().filter(|model| *model == wanted).count();
    for model in ["auto", "mean", "latest", "persistence", "histogram:24", "pergam:3", "calibrated"] {
        assert_eq!(count_of(model), states.len(), "{model}");
    }
    assert_eq!((count_of("hypertime-em:3"), count_of("hypertime-km:3"), count_of("spectral")), (7, 7, 16 * 7));
    assert_eq!(count_of("poisson"), 0);
    assert!(all.stderr.contains("poisson is left out of a, b, c, d, e and 2 more"), "{}", all.stderr);
    // A model that was requested by name is reported as missing.
    let named = evaluate(&door, "door", &states[..1], "mean,poisson");
    named.fails(1, &["poisson is left out of a", "counts"]);
    assert_eq!(named.table_with(1).column("model"), ["mean"]);

    door.tidemap(["map", "create", "short", "--retention", "none"]).table();
    observe(&door, "short", &states[..1]);
    let all = evaluate(&door, "short", &states[..1], "all");
    assert_eq!(all.table().rows.len(), 4 + 16, "auto, mean, latest, ensemble and the orders");
    for model in ["persistence", "histogram:24", "pergam:3", "hypertime-em:3", "hypertime-km:3", "calibrated"] {
        assert!(all.stderr.contains(&format!("{model} is left out of a")), "{model}: {}", all.stderr);
    }
    evaluate(&door, "short", &states[..1], "pergam,mean").fails(1, &["pergam:3", "keeps none", "retention"]);
    let outcome = door.tidemap(["predict", "short", "a", "--at", "1460000000", "--model", "calibrated"]);
    outcome.fails(1, &["calibrated", "\"a\"", "\"short\"", "keeps none", "retention"]);
}

#[test]
fn a_map_chooses_among_the_models_that_it_was_created_with() {
    let Some(door) = Door::new("Europe/London") else { return };
    let models = |name: &str, more: &[&str]| {
        let made = door.tidemap([&["map", "create", name][..], more].concat());
        made.table();
        door.tidemap(["map", "show", name]).table().column("models")[0].to_owned()
    };
    assert_eq!(models("usual", &[]), "spectral histogram calibrated poisson ensemble");
    assert_eq!(models("forgetful", &["--retention", "none"]), "spectral histogram ensemble");
    assert_eq!(models("few", &["--models", "pergam"]), "spectral pergam");
    let all = "spectral histogram calibrated pergam hypertime-em hypertime-km poisson ensemble";
    assert_eq!(models("rich", &["--models", "all"]), all);
    let refused = |more: &[&str]| door.tidemap([&["map", "create", "other"][..], more].concat());
    refused(&["--models", "spectral,fremen"]).fails(2, &["fremen", "hypertime-km", "all"]);
    refused(&["--models", "all", "--retention", "none"]).fails(1, &["calibrated", "keeps none", "retention"]);

    // A week of ten minutes: models are trained once, and scored by the next day.
    observe(&door, "rich", &["a"]);
    let row = |i: i64| format!("{},a,{}\n", 1_451_865_600 + 600 * i, u8::from(i % 6 < 3));
    let later: String = (1000..1300).map(row).collect();
    let sent = cli::tidemap_reading(
        &door.daemon,
        ["observe", "rich", "-", "--label", "2"],
        &format!("time,state,value\n{later}"),
    );
    assert_eq!(sent.table().number("refused"), 0.0);
    door.tidemap(["update", "rich"]).table();
    let shown = door.tidemap(["--output", "csv", "model", "show", "rich", "a"]).stdout;
    let mut lines = shown.lines();
    assert_eq!(lines.next(), Some("mean,n,order,period_secs,amplitude,phase_rad,used,model,recent_errors,auto"));
    for line in lines {
        let tried: Vec<&str> = line.rsplit(',').nth(1).unwrap_or_default().split(' ').collect();
        let names: Vec<&str> = tried.iter().filter_map(|tried| tried.split_once('=')).map(|(name, _)| name).collect();
        let expected =
            ["spectral", "histogram:24", "histogram:weekend:24", "histogram:week:168", "calibrated", "pergam:3"];
        assert_eq!(names, [&expected[..], &["hypertime-em:3", "hypertime-km:3"]].concat(), "{line}");
        assert!(names.contains(&line.rsplit(',').nth(2).unwrap_or_default()), "{line}");
    }
}

#[test]
fn models_that_cannot_be_are_refused() {
    let Some(door) = Door::new("Europe/London") else { return };
    observe(&door, "door", &["door"]);
    let ask = |more: &[&str]| {
        let args = ["predict", "door", "door", "--at", "1460000000"].into_iter().chain(more.iter().copied());
        door.tidemap(args)
    };
    ask(&["--model", "histogram:0"]).fails(2, &["histogram:0", "above 0"]);
    ask(&["--model", "pergam:1000"]).fails(2, &["pergam:1000", "20"]);
    ask(&["--model", "hypertime-em:1000000"]).fails(2, &["hypertime-em:1000000", "50"]);
    ask(&["--model", "histogram:week:10081"]).fails(2, &["10080"]);
    ask(&["--model", "pergam", "--order", "3"]).fails(2, &["--order", "pergam", "auto, spectral and uniform"]);
    let words = ["cells", "pergam", "auto, mean, latest or spectral"];
    ask(&["cell/0/0/0", "--model", "pergam"]).fails(1, &["door", "has no grid"]);
    let path = ["grid", "predict", "door", "--at", "1460000000", "--out", "/nowhere/map.csv", "--model", "pergam"];
    door.tidemap(path).fails(2, &words);
    let table = ask(&["--model", "pergam:20"]).table();
    assert_eq!(table.column("order"), ["0"]);
}
