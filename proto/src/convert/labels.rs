//! Categorical states: their labels when they are added, the shares of an observation, and predictions of all labels.
//!
//! Invariant: predictions of the labels of a state sum to 1 within rounding; shares come in the order of the labels.

use tidemap_map::{event::StateShape, name::StateName};
use tidemap_model::{
    LABELS,
    label_evidence::{entropy_of_labels_bits, normalise},
    models::Interval,
};

use super::{
    InvalidField,
    query::{StateForecast, forecast_to_wire},
};
use crate::v1;

/// Maximum difference between 1 and the sum of the shares of an observation.
pub const SHARES_SUM_TOLERANCE: f64 = 1e-6;

/// The shares of an observation, with its index.
pub type PlacedShares = (u32, Box<[f64]>);

/// The states of the labels of a state to be added.
///
/// # Errors
/// Too few or too many labels, an invalid one, or one that is named twice.
pub fn labels_from_wire(name: &StateName, labels: &[String]) -> Result<Vec<StateName>, InvalidField> {
    if !LABELS.contains(&labels.len()) {
        let text = format!("{} labels: a categorical state has {} to {}", labels.len(), LABELS.start(), LABELS.end());
        return Err(InvalidField::new("labels", text));
    }
    let mut known: Vec<StateName> = Vec::with_capacity(labels.len());
    for (i, label) in labels.iter().enumerate() {
        let field = || format!("labels[{i}]");
        let label_name = name.label(label).map_err(|error| InvalidField::new(field(), error))?;
        if known.contains(&label_name) {
            return Err(InvalidField::new(field(), format!("label {label:?} is named twice")));
        }
        known.push(label_name);
    }
    Ok(known)
}

/// The shares of the observations of a message, each with the index of its observation; `labels` returns how many
/// shares an observation of a name has, by its index in the stream's table, `None` for one that has none.
///
/// # Errors
/// The number of shares does not match the observations.
pub fn shares(
    state_indices: &[u32],
    shares: &[f64],
    labels: impl Fn(u32) -> Option<usize>,
) -> Result<Vec<PlacedShares>, InvalidField> {
    let counted = || (0..).zip(state_indices).filter_map(|(i, &index)| Some((i, labels(index)?)));
    let wanted: usize = counted().map(|(_, count)| count).sum();
    if wanted != shares.len() {
        let text = format!("{} entries: the observations of shares in this message have {wanted}", shares.len());
        return Err(InvalidField::new("observations.shares", text));
    }
    let mut rest = shares;
    let own = |(i, count): (u32, usize)| {
        let (own, others) = rest.split_at_checked(count)?;
        rest = others;
        Some((i, Box::from(own)))
    };
    Ok(counted().map_while(own).collect())
}

/// Describes what is wrong with the shares of an observation; `None`: nothing.
#[must_use]
pub fn invalid_shares(shares: &[f64]) -> Option<String> {
    if let Some(wrong) = shares.iter().find(|share| !(0.0..=1.0).contains(*share)) {
        return Some(format!("share {wrong} is not between 0 and 1"));
    }
    let sum: f64 = shares.iter().sum();
    let is_one = (sum - 1.0).abs() <= SHARES_SUM_TOLERANCE;
    (!is_one).then(|| format!("the shares of the labels have the sum {sum}, not 1"))
}

/// Whether an observation of this shape is a label (0 of a message's dimensions), or has a share of each label.
#[must_use]
pub fn shares_of(shape: StateShape) -> Option<usize> {
    match shape {
        StateShape::Categorical(count) if count > 0 => Some(usize::from(count)),
        _ => None,
    }
}

/// Predictions of all labels of the name at `state_index` of a question, in order, from the time at `first_time_index`
/// on, for the wire: one reply for each label.
#[must_use]
pub fn label_forecasts_to_wire(
    state_index: usize,
    first_time_index: usize,
    forecasts: Vec<(String, StateForecast)>,
) -> Vec<v1::PredictStatesResponse> {
    let (names, mut forecasts): (Vec<String>, Vec<StateForecast>) = forecasts.into_iter().unzip();
    let times = forecasts.iter().map(|forecast| forecast.values.len()).min().unwrap_or(0);
    let mut entropies = Vec::with_capacity(times);
    for time in 0..times {
        let mut shares: Vec<f64> = forecasts.iter().map(|forecast| forecast.values[time]).collect();
        let sum = normalise(&mut shares);
        entropies.push(entropy_of_labels_bits(&shares));
        for (forecast, share) in forecasts.iter_mut().zip(&shares) {
            forecast.values[time] = *share;
            if let Some(held) = forecast.intervals.get_mut(time) {
                let Interval { lower, upper } = held.interval;
                held.interval = Interval { lower: (lower / sum).min(*share), upper: (upper / sum).clamp(*share, 1.0) };
            }
        }
    }
    let reply = |((label, forecast), axis): ((String, StateForecast), u32)| v1::PredictStatesResponse {
        label,
        entropies_bits: entropies.clone(),
        ..forecast_to_wire(state_index, axis, first_time_index, forecast)
    };
    names.into_iter().zip(forecasts).zip(1..).map(reply).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(labels: &[&str]) -> Result<Vec<StateName>, InvalidField> {
        let labels: Vec<String> = labels.iter().map(|label| (*label).to_owned()).collect();
        labels_from_wire(&StateName::new("activity").expect("valid"), &labels)
    }

    #[test]
    fn labels_are_two_to_sixty_four_different_words() {
        let names: Vec<_> = labels(&["sleep", "eat"]).expect("right").iter().map(ToString::to_string).collect();
        assert_eq!(names, ["activity/sleep", "activity/eat"]);
        let wrong = |names: &[&str]| labels(names).expect_err("wrong").field;
        assert_eq!(wrong(&["sleep"]), "labels");
        let many: Vec<String> = (0..65).map(|number| number.to_string()).collect();
        assert_eq!(wrong(&many.iter().map(String::as_str).collect::<Vec<_>>()), "labels");
        assert_eq!(wrong(&["sleep", "eat", "sleep"]), "labels[2]");
        assert_eq!(wrong(&["sleep", "x"]), "labels[1]");
    }

    #[test]
    fn shares_are_those_of_their_observations() {
        let labels = |index: u32| [None, Some(2), Some(3)][index as usize];
        let numbers = [0.5, 0.5, 1.0, 0.0, 0.0];
        let found = shares(&[0, 1, 2], &numbers, labels).expect("as many as requested");
        assert_eq!(found, [(1, Box::from([0.5, 0.5])), (2, Box::from([1.0, 0.0, 0.0]))]);
        assert_eq!(shares(&[0, 1], &numbers, labels).expect_err("too many").field, "observations.shares");
    }

    #[test]
    fn shares_have_the_sum_one() {
        assert_eq!(invalid_shares(&[0.25, 0.75]), None);
        assert_eq!(invalid_shares(&[0.25, 0.750_000_5]), None);
        assert!(invalid_shares(&[0.25, 0.750_002]).is_some_and(|text| text.contains("the sum 1.00000")));
        assert!(invalid_shares(&[-0.25, 1.25]).is_some_and(|text| text.contains("share -0.25")));
        assert!(invalid_shares(&[f64::NAN, 1.0]).is_some());
    }
}
