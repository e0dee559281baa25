//! The texts of the demo.
//!
//! Invariant: plain text, at most 100 columns wide, for readers who are new to tidemap.

use std::{
    fmt::{self, Write as _},
    path::Path,
};

use tidemap_client::queries::{ModelDescription, ModelKind};
use tidemap_formats::table::numbers::period;

use super::{
    MAP,
    forecast::{Forecast, errors},
    picture, words,
};

/// Number of components whose periods are listed; the others are counted.
const COMPONENTS_LISTED: usize = 4;

/// The text before the first week.
pub(super) fn opening(weeks: u32, robots: &[&str], states: usize, address: &str) -> Result<String, fmt::Error> {
    let mut text = String::new();
    writeln!(text, "tidemap demo: {weeks} weeks in a simulated office\n")?;
    writeln!(text, "  {} robots ({}) drive around an office in London. Whenever one", robots.len(), robots.join(", "))?;
    writeln!(text, "  passes a door or a room it notes whether the door is open, or somebody is in. They pass at odd")?;
    writeln!(
        text,
        "  times, rest to charge, and see one place at a time: of {states} states, most minutes go unseen.\n"
    )?;
    writeln!(text, "  A tidemapd of its own (at {address}) takes every observation in over gRPC, and acknowledges")?;
    writeln!(text, "  it once it is on disk. Whenever the data passes midnight, it learns from the day that ended.\n")?;
    writeln!(text, "  After each week: the error of its forecast of the next day.\n")?;
    writeln!(text, "  week  until        observations   mean squared error of the forecast, all {states} states")?;
    writeln!(text, "                     so far         plain mean    tidemap")?;
    Ok(text)
}

/// The line after each week.
pub(super) fn week(week: u32, last_day: &str, observations: u64, forecasts: &[Forecast]) -> Result<String, fmt::Error> {
    let (error, plain) = errors(forecasts);
    let mut text = String::new();
    writeln!(
        text,
        "  {week:>4}  {last_day:<11}  {:>12}   {plain:>10.3} {error:>10.3}   {}",
        words::count(observations),
        words::comparison(error, plain)
    )?;
    Ok(text)
}

/// The forecast of a working day, with the model of each state.
pub(super) fn tomorrow(day: &str, shown: &[(Forecast, ModelDescription)]) -> Result<String, fmt::Error> {
    let mut text = String::new();
    writeln!(text, "\nTomorrow, {day}, as tidemap predicts it, and the actual day\n")?;
    for (forecast, model) in shown {
        let (error, plain) = (forecast.error(), forecast.plain_error());
        writeln!(
            text,
            "{}: by {}, from {} observations; error {error:.3}, plain mean {plain:.3} ({})",
            forecast.state,
            chosen(model),
            words::count(forecast.observations),
            words::comparison(error, plain)
        )?;
        writeln!(text, "  {}", rhythms(model))?;
        writeln!(text, "{}{}", picture::day(&forecast.predicted, &forecast.truth), picture::hours())?;
    }
    Ok(text)
}

/// The forecast of a day off.
pub(super) fn day_off(day: &str, forecasts: &[Forecast], shown: &[&str]) -> Result<String, fmt::Error> {
    let (error, plain) = errors(forecasts);
    let mut text = String::new();
    writeln!(text, "For contrast, a day off: {day}")?;
    let compared = words::comparison(error, plain);
    writeln!(text, "(all {} states: error {error:.3}, plain mean {plain:.3}, {compared})\n", forecasts.len())?;
    for forecast in forecasts.iter().filter(|forecast| shown.contains(&forecast.state)) {
        writeln!(text, "{}: error {:.3}, plain mean {:.3}", forecast.state, forecast.error(), forecast.plain_error())?;
        writeln!(text, "{}{}", picture::day(&forecast.predicted, &forecast.truth), picture::hours())?;
    }
    Ok(text)
}

/// The legend of the pictures.
pub(super) fn lesson() -> &'static str {
    "Meanings
  predicted   how probable it is that the door is open, or the room occupied: full bar 1, line 0
  truth       the actual state then: █ open or occupied, · not, ░▒ for a part of these 20 minutes
  by          the model that predicts it. Every night tidemap scores its models on the day that
              ended: sums of 0 to 15 rhythms (spectral), three histograms, a profile of day and week
              (calibrated), recent days. The ensemble weights them by their errors.
  rhythms     those that were found: their periods, strongest first, and how far each swings the
              probability up and down. A habit of every day takes 24 h and its fractions, one of
              some weekdays 7 d and its; a door that is always open has none.
  error       mean squared error over the day: 0 is perfect, a guess of 0.5 all day is 0.25
"
}

/// The last text, after the daemon is removed.
pub(super) fn ended(program: &str) -> Result<String, fmt::Error> {
    let mut text =
        String::from("\nThe daemon has been stopped and its data removed. To send requests to it yourself, type\n\n");
    writeln!(text, "  {program} demo --keep\n")?;
    writeln!(text, "which leaves it running, and prints the next commands and the address of its page.")?;
    Ok(text)
}

/// The last text, if the daemon is kept.
pub(super) fn kept(program: &str, address: &str, http: &str, pid: u32, folder: &Path) -> Result<String, fmt::Error> {
    let mut text = String::from("\nThe daemon is still running. Send requests to it:\n\n");
    writeln!(text, "  export TIDEMAP_SERVER=http://{address}")?;
    for command in [
        "state list office",
        "model show office meeting-room",
        "predict office kitchen --at 2025-04-16T12:30:00+01:00",
        "predict office kitchen --from 2025-04-16T00:00:00+01:00 --to 2025-04-17T00:00:00+01:00 --step 1h",
    ] {
        writeln!(text, "  {program} {command}")?;
    }
    writeln!(text, "\nAnd when you have seen enough:\n")?;
    writeln!(text, "  kill {pid}; sleep 1; rm -r {}", folder.display())?;
    writeln!(text, "\nOpen it in a browser, where time is a slider:\n")?;
    writeln!(text, "  http://{http}/states/{MAP}?select=kitchen&at=2025-04-16T12:30:00%2B01:00")?;
    Ok(text)
}

/// The chosen model.
fn chosen(model: &ModelDescription) -> String {
    match model.chosen.kind {
        ModelKind::Spectral => format!("spectral of order {}", model.order),
        _ => model.chosen.to_string(),
    }
}

/// The periodic components of the spectral model.
fn rhythms(model: &ModelDescription) -> String {
    let used = model.components.len().min(model.order as usize);
    if used == 0 {
        return format!("rhythms: none that would help; the mean is {:.2}", model.mean);
    }
    let listed: Vec<String> = model.components[..used.min(COMPONENTS_LISTED)]
        .iter()
        .map(|component| format!("{} ±{:.2}", period(component.period_secs), component.amplitude))
        .collect();
    let more = match used.saturating_sub(COMPONENTS_LISTED) {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    format!("rhythms: {}{more}, around a mean of {:.2}", listed.join(", "), model.mean)
}

#[cfg(test)]
mod tests {
    use tidemap_client::{
        maps::StateKind,
        queries::{ModelSelector, SpectralComponent},
    };

    use super::*;

    fn model(order: u32) -> ModelDescription {
        let component = |period_secs: f64| SpectralComponent { period_secs, amplitude: 0.25, phase_rad: 0.0 };
        ModelDescription {
            state: "kitchen".to_owned(),
            kind: StateKind::Probability,
            mean: 0.25,
            learned_observations: 10,
            observations: 12,
            order,
            components: [1.0, 2.0, 7.0, 14.0, 21.0].map(|part| component(7.0 * 86_400.0 / part)).to_vec(),
            order_errors: Vec::new(),
            persistence_tau_secs: 3600.0,
            last_value: None,
            last_nanos: None,
            first_nanos: None,
            chosen: ModelSelector::default(),
            model_errors: Vec::new(),
            change_date: None,
        }
    }

    #[test]
    fn rhythms_are_those_that_predictions_use() {
        assert_eq!(rhythms(&model(0)), "rhythms: none that would help; the mean is 0.25");
        assert_eq!(rhythms(&model(1)), "rhythms: 7 d ±0.25, around a mean of 0.25");
        assert!(rhythms(&model(5)).contains("7 d ±0.25, 3.5 d ±0.25, 24 h ±0.25, 12 h ±0.25, and 1 more"));
    }

    #[test]
    fn nothing_is_wider_than_100_columns() -> Result<(), fmt::Error> {
        let forecast = Forecast {
            state: "office-3-door",
            observations: 123_456,
            predicted: vec![0.5; 288],
            plain: vec![0.5; 288],
            truth: vec![1.0; 288],
        };
        let robots = ["robot-ada", "robot-bob", "robot-cleo"];
        let text = [
            opening(52, &robots, 9, "127.0.0.1:12345")?,
            week(52, "Mon 14 Apr", 123_456, std::slice::from_ref(&forecast))?,
            tomorrow("Tuesday 15 April 2025", &[(forecast.clone(), model(15))])?,
            day_off("Saturday 19 April 2025", std::slice::from_ref(&forecast), &["office-3-door"])?,
            lesson().to_owned(),
            ended("target/release/tidemap")?,
        ]
        .concat();
        for line in text.lines() {
            assert!(line.chars().count() <= 100, "{line}");
        }
        Ok(())
    }
}
