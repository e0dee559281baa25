//! A sensor on the command line: `hit=0.9,false-alarm=0.05`.
//!
//! Invariant: an error names the invalid part and the correct form.

use tidemap_client::observe::ProducerSensor;

/// Parses a sensor; omitted values are the values of a perfect sensor.
pub(crate) fn sensor(text: &str) -> Result<ProducerSensor, String> {
    let (mut hit, mut false_alarm) = (None, None);
    for part in text.split(',') {
        let (name, value) = part.split_once('=').unwrap_or((part, ""));
        let (name, known) = match name.trim() {
            "hit" => ("hit", &mut hit),
            "false-alarm" => ("false-alarm", &mut false_alarm),
            _ => return Err(format!("{part:?}: a sensor has hit=P and false-alarm=P, with a comma between")),
        };
        let number = value.trim().parse::<f64>().ok().filter(|number| (0.0..=1.0).contains(number));
        let number = number.ok_or_else(|| format!("{name}={}: has to be a number from 0 to 1", value.trim()))?;
        if known.replace(number).is_some() {
            return Err(format!("{name} is given twice"));
        }
    }
    let sensor = ProducerSensor { hit: hit.unwrap_or(1.0), false_alarm: false_alarm.unwrap_or(0.0) };
    if sensor.hit > sensor.false_alarm { Ok(sensor) } else { Err("hit has to be above false-alarm".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn omitted_values_are_those_of_a_perfect_sensor() {
        assert_eq!(sensor("hit=0.9,false-alarm=0.05"), Ok(ProducerSensor { hit: 0.9, false_alarm: 0.05 }));
        assert_eq!(sensor("false-alarm=0.05"), Ok(ProducerSensor { hit: 1.0, false_alarm: 0.05 }));
        assert_eq!(sensor("hit=0.9"), Ok(ProducerSensor { hit: 0.9, false_alarm: 0.0 }));
    }

    #[test]
    fn a_mistake_names_the_part() {
        for (text, words) in [
            ("", "hit=P"),
            ("prior=0.5", "\"prior=0.5\""),
            ("hit=often", "hit=often"),
            ("hit=NaN", "hit=NaN"),
            ("hit", "hit="),
            ("hit=1.2", "from 0 to 1"),
            ("hit=0.9,hit=0.8", "hit is given twice"),
            ("hit=0.3,false-alarm=0.4", "above false-alarm"),
            ("false-alarm=1", "above false-alarm"),
        ] {
            let error = sensor(text).expect_err(text);
            assert!(error.contains(words), "{text}: {error}");
        }
    }
}
