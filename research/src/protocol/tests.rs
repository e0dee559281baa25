//! Protocols are read completely, and errors name the line and the allowed values.

#![allow(clippy::unwrap_used)]

use std::path::Path;

use tidemap_model::selector::Blend;

use super::*;

/// A protocol in which each key has a line of its own.
const WHOLE: &str = "\
name: door
zone: Europe/London
train: [data/train.csv]
test: [week1.csv, more/week1.csv, week2.csv]
retrain: each
states: [door, lamp]
models:
  - mean
  - histogram: {bins: [12, 24], cycle: [day, week]}
  - spectral: {name: fremen, order: 3, period_base: 7d, period_count: 168}
  - calibrated:
tuning: {folds: 4, fold: 7d}
baseline: fremen
significance: 0.1
predictions: 5m
out: results
";

fn parsed(text: &str) -> Result<Protocol, ProtocolError> {
    parse(text, "stem", Path::new("lab"))
}

#[track_caller]
fn refused(text: &str) -> String {
    parsed(text).expect_err(text).to_string()
}

/// The whole protocol with one line replaced; lines of the message are lines of the file.
#[track_caller]
fn refused_with(line: &str, other: &str) -> String {
    assert!(WHOLE.contains(line), "{line}");
    refused(&WHOLE.replace(line, other))
}

#[test]
fn everything_of_a_protocol_is_read() {
    let protocol = parsed(WHOLE).unwrap();
    assert_eq!(protocol.name, "door");
    assert_eq!(protocol.zone.name(), "Europe/London");
    assert_eq!(protocol.train, [Path::new("lab/data/train.csv")]);
    let tests: Vec<(&str, &Path)> = protocol.test.iter().map(|test| (&*test.label, &*test.path)).collect();
    let path = Path::new;
    // Two files of one name are distinguished.
    assert_eq!(
        tests,
        [("week1", path("lab/week1.csv")), ("week1-2", path("lab/more/week1.csv")), ("week2", path("lab/week2.csv"))]
    );
    assert_eq!(protocol.retrain, Retrain::Each);
    assert_eq!(protocol.states, ["door", "lamp"]);
    assert_eq!(protocol.tuning, Some(Tuning { folds: 4, fold_nanos: 7 * 86_400 * 1_000_000_000 }));
    assert_eq!((protocol.baseline, protocol.significance), (2, 0.1));
    assert_eq!(protocol.predictions, Predictions::Every { nanos: 300 * 1_000_000_000 });
    assert_eq!(protocol.out, Path::new("lab/results"));
    let models: Vec<(&str, Vec<&str>)> = protocol
        .models
        .iter()
        .map(|model| (&*model.label, model.sets.iter().map(|set| set.shown()).collect()))
        .collect();
    let histograms = ["bins=12 cycle=day", "bins=12 cycle=week", "bins=24 cycle=day", "bins=24 cycle=week"].to_vec();
    assert_eq!(
        models,
        [
            ("mean", vec![""]),
            ("histogram", histograms),
            ("fremen", vec!["order=3 period_base=7d period_count=168"]),
            ("calibrated", vec![""]),
        ]
    );
}

#[test]
fn what_may_be_left_out_has_a_default() {
    let protocol =
        parsed("zone: UTC\ntrain: a.csv\ntest: b.csv\nmodels: [mean, spectral]\npredictions: off\nout: o").unwrap();
    assert_eq!(protocol.name, "stem");
    assert_eq!((protocol.kind, protocol.format), (StateKind::Probability, RowFormat::Csv));
    assert_eq!((protocol.retrain, protocol.tuning), (Retrain::Never, None));
    assert_eq!((protocol.baseline, protocol.significance), (0, 0.05));
    assert_eq!(protocol.predictions, Predictions::Off);
    assert!(protocol.states.is_empty());
}

#[test]
fn an_unknown_key_is_named_with_its_line_and_the_keys_there_are() {
    let message = refused_with("retrain: each", "retrains: each");
    assert!(message.contains("line 5") && message.contains("retrains") && message.contains("retrain,"), "{message}");
    let message = refused_with("{folds: 4, fold: 7d}", "{folds: 4, length: 7d}");
    assert!(message.contains("line 12") && message.contains("length") && message.contains("fold"), "{message}");
}

#[test]
fn an_unknown_model_is_named_with_the_models_there_are() {
    assert_eq!(
        refused_with("  - mean", "  - fremen"),
        "line 8: model is \"fremen\": it has to be one of: mean, latest, persistence, histogram, spectral, uniform, \
         pergam, hypertime-em, hypertime-km, poisson, calibrated, ensemble, average"
    );
    assert!(refused_with("  - mean", "  - auto").starts_with("line 8: model is \"auto\""));
}

#[test]
fn wrong_parameters_are_named_with_the_right_ones() {
    assert_eq!(
        refused_with("bins: [12, 24]", "bims: [12, 24]"),
        "line 9: model histogram: \"bims\" is not a parameter of it: use bins, cycle, smoothing_bins, prior_readings \
         or name"
    );
    assert_eq!(
        refused_with("  - mean", "  - mean: {order: 3}"),
        "line 8: model mean: \"order\" is not a parameter of it: it has none but name"
    );
    assert_eq!(
        refused_with("bins: [12, 24]", "bins: [12, many]"),
        "line 9: bins of histogram is \"many\": it has to be a whole number from 1"
    );
    assert_eq!(
        refused_with("order: 3", "order: 16"),
        "line 10: order of spectral is \"16\": it has to be a whole number from 0 to 15"
    );
    assert_eq!(
        refused_with("bins: [12, 24]", "bins: [12, 2000]"),
        "line 9: model histogram: bins is 2000, expected 1 to 1440 bins of the day"
    );
    assert!(refused_with("period_base: 7d", "period_base: seven").contains("period_base of spectral is \"seven\""));
    assert!(refused_with("period_count: 168", "period_count: 0").contains("0 periodicities, expected 1 to 2048"));
    assert!(refused_with("bins: [12, 24]", "bins: []").contains("bins is an empty list"));
}

#[test]
fn a_list_that_nothing_chooses_from_is_refused() {
    assert_eq!(
        refused_with("tuning: {folds: 4, fold: 7d}\n", ""),
        "line 9: model histogram: bins lists 2 values and nothing chooses one: write tuning: {folds: 4, fold: 7d}, or \
         one value, or lists: each to compare all"
    );
}

#[test]
fn wrong_values_are_named_with_their_lines() {
    for (line, other, begins) in [
        ("zone: Europe/London", "zone: Mars/Base", "line 2: zone is \"Mars/Base\": it has to be the IANA time zone"),
        ("retrain: each", "retrain: daily", "line 5: retrain is \"daily\": it has to be one of: never, each"),
        ("folds: 4", "folds: 0", "line 12: folds is \"0\": it has to be a whole number"),
        ("fold: 7d", "fold: week", "line 12: fold is \"week\": it has to be a duration"),
        (
            "baseline: fremen",
            "baseline: spectral",
            "line 13: baseline is \"spectral\": it has to be one of the models: mean, histogram, fremen, calibrated",
        ),
        ("significance: 0.1", "significance: 5", "line 14: significance is \"5\": it has to be a number from 0.001"),
        ("significance: 0.1", "significance: .nan", "line 14: significance is"),
        ("predictions: 5m", "predictions: some", "line 15: predictions is \"some\": it has to be all, off, or a"),
        ("[door, lamp]", "[door, door]", "line 6: states is \"door\": it has to be each state once"),
        ("test: [week1.csv,", "test: [week2.csv,", "line 4: test is \"week2.csv\": it has to be each file once"),
    ] {
        let message = refused_with(line, other);
        assert!(message.starts_with(begins), "{message}");
    }
}

const LAGS: &str = "zone: UTC\ntrain: a.csv\ntest: b.csv\nahead: [next, 90m]\nmodels: [mean, mean+memory]\nout: o\n";

#[test]
fn lags_and_blends_are_read() {
    let protocol = parsed(LAGS).unwrap();
    assert_eq!(protocol.ahead, [Ahead::Next, Ahead::Nanos(90 * 60 * 1_000_000_000)]);
    assert_eq!(protocol.ahead.iter().map(Ahead::to_string).collect::<Vec<_>>(), ["next", "90m"]);
    let labels: Vec<&str> = protocol.models.iter().map(|model| model.label.as_str()).collect();
    assert_eq!(labels, ["mean", "mean+memory"]);
    assert!(
        !protocol.models[0].sets[0].blend().is_blended() && protocol.models[1].sets[0].blend().blend == Blend::Memory
    );
    assert!(parsed(WHOLE).unwrap().ahead.is_empty());
    assert_eq!(parsed(&LAGS.replace("[next, 90m]", "1h")).unwrap().ahead, [Ahead::Nanos(3600 * 1_000_000_000)]);
}

#[test]
fn wrong_lags_and_blends_are_named() {
    for (from, to, begins) in [
        ("90m", "soon", "line 4: ahead is \"soon\": it has to be next (the reading before is known), or a duration"),
        ("90m", "0h", "line 4: ahead is \"0h\": it has to be next"),
        ("90m", "next", "line 4: ahead is \"next\": it has to be each once"),
        ("90m", "1h, 60m", "line 4: ahead is \"60m\": it has to be each once"),
        ("next, 90m", "", "line 4: ahead is \"a list of 0\": it has to be 1 to 32 times"),
        ("mean+memory", "mean+luck", "line 5: model mean+luck: \"mean+luck\": the only suffixes are +persistence"),
        ("mean+memory", "mad+memory", "line 5: model is \"mad+memory\": it has to be one of: mean, latest"),
        ("mean+memory", "latest+memory", "line 5: model latest+memory: latest uses the newest reading"),
        ("ahead: [next, 90m]", "retrain: each", "line 5: model mean+memory: +memory draws predictions towards the"),
    ] {
        let message = refused(&LAGS.replacen(from, to, 1));
        assert!(message.starts_with(begins), "{message}");
    }
}

#[test]
fn lists_without_tuning_are_models_of_their_own_where_asked() {
    let text = WHOLE.replace("tuning: {folds: 4, fold: 7d}", "lists: each");
    let labels = |text: &str| -> Vec<String> {
        parsed(text).unwrap().models.into_iter().map(|model| model.label).collect::<Vec<_>>()
    };
    assert_eq!(
        labels(&text)[..4],
        ["mean", "histogram bins=12 cycle=day", "histogram bins=12 cycle=week", "histogram bins=24 cycle=day"]
    );
    assert_eq!(labels(&text.replace("lists: each", "lists: each\n").replace("[12, 24]", "12")).len(), 5);
    let message = refused_with("significance: 0.1", "lists: each");
    assert!(message.starts_with("line 14: lists is \"each\": it has to be left out beside tuning"), "{message}");
    let message = refused_with("significance: 0.1", "lists: all");
    assert!(message.starts_with("line 14: lists is \"all\": it has to be one of: tuned, each"), "{message}");
    let bins = (1..=101).map(|bins| bins.to_string()).collect::<Vec<_>>().join(", ");
    let message = refused(&text.replace("12, 24", &bins));
    assert!(message.contains("with its lists, there are more than 100 models"), "{message}");
}

#[test]
fn a_file_of_the_training_data_may_be_a_test_set() {
    let text = WHOLE.replace("[week1.csv,", "[./data/train.csv, week1.csv,");
    let learned: Vec<(String, bool)> =
        parsed(&text).unwrap().test.into_iter().map(|file| (file.label, file.is_learned)).collect();
    assert_eq!(learned[..2], [("train".to_owned(), true), ("week1".to_owned(), false)]);
}

#[test]
fn missing_keys_are_named() {
    for (line, begins) in [
        ("zone: Europe/London\n", "key zone is missing: write the IANA time zone"),
        ("train: [data/train.csv]\n", "key train is missing: write a list of files"),
        ("test: [week1.csv, more/week1.csv, week2.csv]\n", "key test is missing: write a list of files"),
        ("out: results\n", "key out is missing: write the folder"),
    ] {
        assert!(refused_with(line, "").starts_with(begins), "{}", refused_with(line, ""));
    }
    assert!(refused("zone: UTC\ntrain: a\ntest: b\nmodels: []\nout: o").starts_with("key models is missing"));
}

#[test]
fn two_models_of_one_name_are_refused() {
    assert_eq!(
        refused_with("  - calibrated:", "  - mean"),
        "line 11: model mean: two models have the name \"mean\": set another name, as in mean: {name: other}"
    );
}

#[test]
fn a_model_of_counts_needs_counts() {
    assert!(refused_with("  - mean", "  - poisson").starts_with("line 8: model poisson: it is a model of counts"));
    assert!(parsed(&WHOLE.replace("  - mean", "  - poisson").replace("name: door", "kind: count")).is_ok());
}

#[test]
fn a_file_that_is_no_protocol_is_refused_with_a_line() {
    for text in
        ["models: [mean\n", "time,state,value\n1,door,0\n", "", "- mean\n", "zone: UTC\nzone: UTC\n", "zone: [UTC]\n"]
    {
        let message = refused(text);
        assert!(message.contains("line ") || message.starts_with("key "), "{text:?}: {message}");
        assert!(!message.contains('\n'), "{message}");
    }
    // One model a dash.
    let message = refused_with("  - mean", "  - {mean: , latest: }");
    assert!(message.contains("line 8") && message.contains("dash"), "{message}");
}

#[test]
fn too_many_combinations_are_refused_before_they_are_made() {
    let values = (1..=300).map(|bins| bins.to_string()).collect::<Vec<_>>().join(", ");
    let lists = format!("bins: [{values}], smoothing_bins: [{values}], prior_readings: [{values}], cycle: [day, week]");
    let message = refused_with("bins: [12, 24], cycle: [day, week]", &lists);
    assert!(message.contains("more than 10000 combinations"), "{message}");
}
