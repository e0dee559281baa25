//! Tests models by their names: names that are read, written and refused.

use super::*;

#[test]
fn models_are_named_as_on_the_command_line() {
    for text in [
        "auto",
        "mean",
        "latest",
        "persistence",
        "histogram:48",
        "histogram:24",
        "histogram:week:168",
        "histogram:weekend:12+persistence",
        "histogram:weekend:12",
        "pergam:1:90m",
        "pergam:20:25h",
        "pergam:2:61s",
        "pergam:2:366d",
        "spectral+persistence",
        "pergam:3",
        "pergam:3:7d",
        "pergam:2:36h+persistence",
        "pergam:20:90s",
        "pergam:1:60.5s",
        "uniform",
        "uniform+persistence",
        "hypertime-em:5",
        "hypertime-km:5",
        "poisson",
        "calibrated+persistence",
        "auto+memory",
        "pergam:2:36h+memory",
    ] {
        let model: ModelSelector = text.parse().expect(text);
        assert_eq!(model.to_string(), text);
    }
    for kind in ModelKind::ALL {
        assert_eq!(kind.to_string().parse(), Ok(ModelSelector { kind, ..ModelSelector::default() }));
        assert_eq!(kind.name().parse(), Ok(ModelSelector { kind, ..ModelSelector::default() }));
    }
    for (short, long) in [("histogram:week", "histogram:week:168"), ("histogram:day", "histogram:24")] {
        assert_eq!(short.parse::<ModelSelector>(), long.parse());
    }
}

#[test]
fn the_error_states_what_is_wrong_with_a_name() {
    let parsed = |text: &str| text.parse::<ModelSelector>();
    assert_eq!(parsed("fremen"), Err(InvalidModel::Unknown("fremen".to_owned())));
    assert_eq!(parsed(""), Err(InvalidModel::Unknown(String::new())));
    assert_eq!(parsed("spectral:2"), Err(InvalidModel::Parameter("spectral".to_owned())));
    for text in ["histogram:", "histogram:0", "histogram:month:3", "pergam:week:3", "histogram:24:7", "pergam:-1"] {
        assert_eq!(parsed(text), Err(InvalidModel::NotANumber(text.to_owned())));
    }
    assert_eq!(parsed("uniform:2"), Err(InvalidModel::Parameter("uniform".to_owned())));
    for text in ["histogram:24:7d", "histogram:week:24:7d", "hypertime-em:3:7d"] {
        assert_eq!(parsed(text), Err(InvalidModel::NoPeriod(text.to_owned())));
    }
    for text in ["pergam:3:59s", "pergam:3:367d"] {
        assert_eq!(parsed(text), Err(InvalidModel::PeriodRange(text.to_owned())));
    }
    for text in ["pergam:3:7", "pergam:3:", "pergam:3:often", "pergam:3:-7d", "pergam:3:0d"] {
        let error = parsed(text).expect_err(text).to_string();
        assert!(error.contains("pergam:3:7d") && error.contains("duration"), "{error}");
    }
    assert_eq!(parsed("pergam:3:7d:7d"), Err(InvalidModel::NotANumber("pergam:3:7d:7d".to_owned())));
    assert_eq!(parsed("pergam:3:24h"), parsed("pergam:3"));
    for (text, period_nanos) in [("pergam:3:1m", 60_000_000_000), ("pergam:3:366d", 366 * 86_400_000_000_000)] {
        let kind = ModelKind::Pergam { gaussians: 3, period_nanos };
        assert_eq!(parsed(text).map(|model| model.kind), Ok(kind));
    }
    assert_eq!(parsed("mean+x"), Err(InvalidModel::Suffix("mean+x".to_owned())));
    for (text, words) in [
        ("histogram:1441", "at most 1440 bins a day"),
        ("histogram:weekend:1441", "at most 1440 bins a day"),
        ("histogram:week:10081", "at most 10080 bins a week"),
        ("pergam:1000", "pergam takes at most 20 Gaussians"),
        ("hypertime-em:1000000", "hypertime-em takes at most 50 clusters"),
    ] {
        let error = parsed(text).expect_err(text).to_string();
        assert!(error.contains(text) && error.contains(words), "{error}");
    }
    assert!(parsed("histogram:1440").is_ok() && parsed("histogram:week:10080").is_ok());
    assert!(parsed("pergam:20").is_ok() && parsed("hypertime-km:50").is_ok());
}
