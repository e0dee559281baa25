//! Classifications: evidence as input, and the probability of each label as output.
//!
//! Invariant: each label is named once; the handler of the request checks whether the map has the state and its labels.

use tidemap_map::name::StateName;
use tidemap_model::selector::ModelSelector;

use super::{InvalidField, query::selector_from_wire, time::nanos_from_timestamp};
use crate::v1;

/// Part of a classification that is learned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Learning {
    /// Nothing.
    #[default]
    Nothing,
    /// The likeliest label.
    Label,
    /// The probability of each label.
    Shares,
}

/// The question of a classification.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifyQuestion {
    /// The categorical state.
    pub state: StateName,
    /// Time of the observation, nanoseconds UTC; `None`: now.
    pub utc_nanos: Option<i64>,
    /// Labels with the likelihood of what was observed.
    pub likelihoods: Vec<(String, f64)>,
    /// Place of the observation.
    pub place: Option<StateName>,
    /// The model of the temporal prior, which needs no training.
    pub selector: ModelSelector,
    /// Part of the classification that is learned.
    pub learning: Learning,
}

/// The question of a classification.
///
/// # Errors
/// The invalid field.
pub fn classify_from_wire(request: &v1::ClassifyActivityRequest) -> Result<ClassifyQuestion, InvalidField> {
    let v1::ClassifyActivityRequest { state, time, likelihoods, place, model, producer, .. } = request;
    let state = StateName::new(state).map_err(|error| InvalidField::new("state", error))?;
    let utc_nanos = time.map(|time| nanos_from_timestamp("time", time)).transpose()?;
    let place = (!place.is_empty()).then(|| StateName::new(place).map_err(|error| InvalidField::new("place", error)));
    let selector = selector_from_wire("model", *model)?;
    if selector.kind.needs_readings() {
        let text = format!("{selector} has to be trained first: use auto, mean, latest or spectral");
        return Err(InvalidField::new("model.kind", text));
    }
    let mut known: Vec<(String, f64)> = Vec::with_capacity(likelihoods.len());
    for (i, v1::LabelLikelihood { label, likelihood }) in likelihoods.iter().enumerate() {
        if known.iter().any(|(other, _)| other == label) {
            return Err(InvalidField::new(
                format!("likelihoods[{i}].label"),
                format!("label {label:?} is named twice"),
            ));
        }
        known.push((label.clone(), *likelihood));
    }
    if known.is_empty() {
        return Err(InvalidField::new(
            "likelihoods",
            "there is none: give how likely the observation is for each label",
        ));
    }
    let learning = match v1::ActivityLearning::try_from(request.learn) {
        Ok(v1::ActivityLearning::Unspecified | v1::ActivityLearning::Nothing) => Learning::Nothing,
        Ok(v1::ActivityLearning::Label) => Learning::Label,
        Ok(v1::ActivityLearning::Shares) => Learning::Shares,
        Err(_) => return Err(InvalidField::new("learn", format!("{} is not known", request.learn))),
    };
    if learning != Learning::Nothing && producer.is_empty() {
        return Err(InvalidField::new("producer", "missing: an observation that is learned needs a producer"));
    }
    Ok(ClassifyQuestion { state, utc_nanos, likelihoods: known, place: place.transpose()?, selector, learning })
}

/// The probability of one label, with the factors that it is computed from.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelPosterior {
    /// The label.
    pub label: String,
    /// The probability that it holds.
    pub probability: f64,
    /// The likelihood of what was observed, as in the question.
    pub likelihood: f64,
    /// The probability of the label from the time alone.
    pub temporal_prior: f64,
    /// The probability of being at the place while the label holds; `None`: not known.
    pub spatial_prior: Option<f64>,
}

/// All labels of a classification for the wire; the caller adds the result of learning.
#[must_use]
pub fn classification_to_wire(labels: Vec<LabelPosterior>) -> v1::ClassifyActivityResponse {
    let label = |LabelPosterior { label, probability, likelihood, temporal_prior, spatial_prior }| {
        v1::ClassifiedLabel { label, probability, likelihood, temporal_prior, spatial_prior }
    };
    v1::ClassifyActivityResponse {
        labels: labels.into_iter().map(label).collect(),
        ..v1::ClassifyActivityResponse::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> v1::ClassifyActivityRequest {
        v1::ClassifyActivityRequest {
            state: "activity".to_owned(),
            likelihoods: vec![v1::LabelLikelihood { label: "eat".to_owned(), likelihood: 0.7 }],
            ..v1::ClassifyActivityRequest::default()
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |request: v1::ClassifyActivityRequest| classify_from_wire(&request).expect_err("wrong").field;
        assert_eq!(classify_from_wire(&request()).expect("right").learning, Learning::Nothing);
        let twice = [request().likelihoods, request().likelihoods].concat();
        assert_eq!(field(v1::ClassifyActivityRequest { likelihoods: twice, ..request() }), "likelihoods[1].label");
        assert_eq!(field(v1::ClassifyActivityRequest { likelihoods: Vec::new(), ..request() }), "likelihoods");
        let learn = v1::ActivityLearning::Label.into();
        assert_eq!(field(v1::ClassifyActivityRequest { learn, ..request() }), "producer");
        assert_eq!(field(v1::ClassifyActivityRequest { place: "a/b".to_owned(), ..request() }), "place");
        let model = Some(v1::ModelSelector { kind: v1::ModelKind::Calibrated.into(), ..v1::ModelSelector::default() });
        assert_eq!(field(v1::ClassifyActivityRequest { model, ..request() }), "model.kind");
    }
}
