//! Confidence and model of a request for anomalies, what a watch is of, and what was unusual before it was learned.
//!
//! Invariant: a region to watch has at least one cell; whether the map has what is named is not checked.

use tidemap_grid::index::{CellBox, CellIndex};
use tidemap_map::{
    anomaly::{Anomaly, CannotJudge, Confidence, SurpriseQuestion, can_judge, can_watch},
    name::StateName,
};
use tidemap_model::{KEPT_CONFIDENCE, SurpriseRun, selector::ModelSelector};

use super::{
    InvalidField,
    grid::cell_box_from_wire,
    query::selector_from_wire,
    site::location_name_from_wire,
    time::{instant, interval_from_wire, timestamp},
};
use crate::v1;

/// The confidence, 0.99 by default.
///
/// # Errors
/// The confidence is not above 0.5 and at most 1.
pub fn confidence_from_wire(field: &str, wire: Option<f64>) -> Result<Confidence, InvalidField> {
    let confidence = wire.map(Confidence::new).transpose().map_err(|error| InvalidField::new(field, error))?;
    Ok(confidence.unwrap_or_default())
}

/// The model that judges past observations.
///
/// # Errors
/// The errors of [`selector_from_wire`], or the model predicts from the newest value.
pub fn judge_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let selector = selector_from_wire(field, wire)?;
    can_judge(selector).map_err(|error| cannot_judge(field, error))?;
    Ok(selector)
}

/// The model that judges observations as they arrive.
///
/// # Errors
/// The errors of [`selector_from_wire`], or the model predicts from the newest value or must be trained first.
pub fn watching_judge_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let selector = selector_from_wire(field, wire)?;
    can_watch(selector).map_err(|error| cannot_judge(field, error))?;
    Ok(selector)
}

/// The question of a request to watch. Without names, location and region, all states are watched.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchQuestion {
    /// Names of states and cells.
    pub states: Vec<String>,
    /// Name of a location, whose states and cells are watched.
    pub location: Option<StateName>,
    /// A region whose cells are watched.
    pub region: Option<CellBox>,
    /// The confidence from which an observation counts as unexpected.
    pub confidence: Confidence,
    /// The model that judges.
    pub selector: ModelSelector,
}

/// The question of a request to watch.
///
/// # Errors
/// The invalid field.
pub fn watch_from_wire(request: v1::WatchAnomaliesRequest) -> Result<WatchQuestion, InvalidField> {
    let v1::WatchAnomaliesRequest { states, confidence, model, region, location, .. } = request;
    let confidence = confidence_from_wire("confidence", confidence)?;
    let selector = watching_judge_from_wire("model", model)?;
    let location = (!location.is_empty()).then(|| location_name_from_wire("location", &location)).transpose()?;
    let region = region.as_ref().map(cell_box_from_wire);
    if region.is_some_and(|region| region.count() == 0) {
        let text = "the region has no cells: each maximum must be above its minimum";
        return Err(InvalidField::new("region", text));
    }
    Ok(WatchQuestion { states, location, region, confidence, selector })
}

/// Default maximum number of runs in a reply.
const SURPRISES: u32 = 100;
/// Maximum number of runs of one reply.
const SURPRISES_MAX: u32 = 10_000;

/// Names of the states of a request that lists surprises, and its other parameters. Without names: all states.
///
/// # Errors
/// The invalid field.
pub fn surprises_from_wire(request: v1::ListSurprisesRequest) -> Result<(Vec<String>, SurpriseQuestion), InvalidField> {
    let v1::ListSurprisesRequest { states, from_time, to_time, confidence, top, .. } = request;
    let within_nanos = interval_from_wire(from_time, to_time)?;
    let confidence = confidence_from_wire("confidence", confidence)?;
    if confidence.get() < KEPT_CONFIDENCE {
        let text = format!(
            "{} is too low: anomalies are stored from {KEPT_CONFIDENCE} on; use FindAnomalies for a lower confidence",
            confidence.get()
        );
        return Err(InvalidField::new("confidence", text));
    }
    if top > SURPRISES_MAX {
        return Err(InvalidField::new("top", format!("{top} is too many: at most {SURPRISES_MAX} runs")));
    }
    let top = if top == 0 { SURPRISES } else { top };
    Ok((states, SurpriseQuestion { within_nanos, confidence, top: top as usize }))
}

/// Checks that a name is that of a state, and not of a cell.
///
/// # Errors
/// It is the name of a cell.
pub fn no_cell_from_wire(field: &str, name: &str) -> Result<(), InvalidField> {
    match CellIndex::from_name(name) {
        Some(_) => {
            let text = format!("{name}: no anomalies of cells are stored; use FindAnomalies for a cell");
            Err(InvalidField::new(field, text))
        }
        None => Ok(()),
    }
}

/// A run of a state for the wire.
#[must_use]
pub fn surprise_to_wire(state: &str, run: &SurpriseRun) -> v1::Surprise {
    v1::Surprise {
        state: state.to_owned(),
        first_time: Some(timestamp(run.first_nanos)),
        last_time: Some(timestamp(run.last_nanos)),
        observations: run.observations,
        above: run.is_above,
        value: run.value,
        probability: run.probability,
        bits: run.bits,
    }
}

/// The name of a state and a run of it, from a reply; `None` if the reply is not whole.
#[must_use]
pub fn surprise_from_wire(wire: v1::Surprise) -> Option<(String, SurpriseRun)> {
    let v1::Surprise { state, first_time, last_time, observations, above, value, probability, bits } = wire;
    let (first_nanos, last_nanos) = (instant(first_time)?, instant(last_time)?);
    let is_whole = first_nanos <= last_nanos && (0.0..=1.0).contains(&probability) && value.is_finite() && bits >= 0.0;
    // A reply does not state whether a probability is that of the value, and only the daemon needs it.
    let observed_probability = probability;
    let run = SurpriseRun {
        first_nanos,
        last_nanos,
        observations,
        is_above: above,
        value,
        probability,
        observed_probability,
        bits,
    };
    is_whole.then_some((state, run))
}

/// Anomalies of a state or a cell for the wire, in their order.
#[must_use]
pub fn anomalies_to_wire(anomalies: impl IntoIterator<Item = Anomaly>) -> v1::FindAnomaliesResponse {
    let mut reply = v1::FindAnomaliesResponse::default();
    for anomaly in anomalies {
        push(anomaly, &mut reply.times_nanos, &mut reply.values, &mut reply.probabilities);
    }
    reply
}

/// Anomalies of a categorical state for the wire, each with its observed label, in their order.
#[must_use]
pub fn label_anomalies_to_wire(anomalies: impl IntoIterator<Item = (String, Anomaly)>) -> v1::FindAnomaliesResponse {
    let (labels, anomalies): (Vec<String>, Vec<Anomaly>) = anomalies.into_iter().unzip();
    v1::FindAnomaliesResponse { labels, ..anomalies_to_wire(anomalies) }
}

/// Anomalies of a watch for the wire, each with the name of its state or cell, in their order. `missed`: the number of
/// observations that were not judged.
#[must_use]
pub fn watched_to_wire(
    anomalies: impl IntoIterator<Item = (String, Anomaly)>,
    missed: u64,
) -> v1::WatchAnomaliesResponse {
    let mut reply = v1::WatchAnomaliesResponse { missed_observations: missed, ..Default::default() };
    for (state, anomaly) in anomalies {
        reply.states.push(state);
        push(anomaly, &mut reply.times_nanos, &mut reply.values, &mut reply.probabilities);
    }
    reply
}

/// Adds an anomaly to the columns of a reply.
fn push(anomaly: Anomaly, times_nanos: &mut Vec<i64>, values: &mut Vec<f64>, probabilities: &mut Vec<f64>) {
    times_nanos.push(anomaly.utc_nanos);
    values.push(anomaly.value);
    probabilities.push(anomaly.probability);
}

fn cannot_judge(field: &str, error: CannotJudge) -> InvalidField {
    let name = match error {
        CannotJudge::Blended(blend) => blend.name(),
        CannotJudge::Newest(_) | CannotJudge::NeedsTraining(_) => "kind",
    };
    InvalidField::new(format!("{field}.{name}"), error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_confidence_is_that_of_the_paper_unless_another_is_given() {
        assert_eq!(confidence_from_wire("confidence", None).map(Confidence::get), Ok(0.99));
        assert_eq!(confidence_from_wire("confidence", Some(0.6)).map(Confidence::get), Ok(0.6));
        for wrong in [0.0, 0.5, 1.5, f64::NAN] {
            assert_eq!(
                confidence_from_wire("confidence", Some(wrong)).map_err(|error| error.field),
                Err("confidence".to_owned())
            );
        }
    }

    #[test]
    fn a_model_that_cannot_judge_is_refused_by_the_field_that_makes_it_so() {
        let wire = |kind: v1::ModelKind, persistence| {
            Some(v1::ModelSelector { kind: kind.into(), persistence, ..v1::ModelSelector::default() })
        };
        let field = |error: InvalidField| error.field;
        let judge = |kind, persistence| judge_from_wire("model", wire(kind, persistence)).map_err(field);
        let watching = |kind, persistence| watching_judge_from_wire("model", wire(kind, persistence)).map_err(field);
        assert_eq!(judge_from_wire("model", None), Ok(ModelSelector::default()));
        assert_eq!(judge(v1::ModelKind::Latest, false), Err("model.kind".to_owned()));
        assert_eq!(judge(v1::ModelKind::Auto, true), Err("model.persistence".to_owned()));
        assert!(judge(v1::ModelKind::Calibrated, false).is_ok());
        assert_eq!(watching(v1::ModelKind::Calibrated, false), Err("model.kind".to_owned()));
        assert_eq!(watching(v1::ModelKind::Mean, true), Err("model.persistence".to_owned()));
        assert!(watching(v1::ModelKind::Mean, false).is_ok());
    }

    #[test]
    fn questions_about_anomalies_are_checked() {
        let right = || v1::ListSurprisesRequest {
            from_time: Some(timestamp(5)),
            to_time: Some(timestamp(9)),
            ..Default::default()
        };
        let question_of = |request| surprises_from_wire(request).map(|(_, question)| question);
        let question = question_of(right()).expect("right");
        assert_eq!((question.within_nanos, question.confidence.get(), question.top), (5..9, 0.99, 100));
        let field = |request| question_of(request).expect_err("wrong").field;
        assert_eq!(field(v1::ListSurprisesRequest { confidence: Some(0.8), ..right() }), "confidence");
        assert_eq!(field(v1::ListSurprisesRequest { confidence: Some(2.0), ..right() }), "confidence");
        assert_eq!(field(v1::ListSurprisesRequest { top: 10_001, ..right() }), "top");
        assert_eq!(field(v1::ListSurprisesRequest { to_time: None, ..right() }), "to_time");
    }

    #[test]
    fn a_run_is_read_as_it_was_written_or_refused() {
        let run = SurpriseRun {
            first_nanos: 5,
            last_nanos: 9,
            observations: 3,
            is_above: true,
            value: 1.0,
            probability: 0.01,
            observed_probability: 0.01,
            bits: 6.5,
        };
        let wire = surprise_to_wire("door", &run);
        assert_eq!(surprise_from_wire(wire.clone()), Some(("door".to_owned(), run)));
        assert_eq!(surprise_from_wire(v1::Surprise { last_time: Some(timestamp(4)), ..wire.clone() }), None);
        assert_eq!(surprise_from_wire(v1::Surprise { first_time: None, ..wire.clone() }), None);
        assert_eq!(surprise_from_wire(v1::Surprise { probability: f64::NAN, ..wire }), None);
    }

    #[test]
    fn a_watch_of_nothing_in_particular_is_of_all_states() {
        let question = watch_from_wire(v1::WatchAnomaliesRequest::default()).expect("right");
        assert!(question.states.is_empty() && question.location.is_none() && question.region.is_none());
    }

    #[test]
    fn what_is_wrong_of_a_watch_is_named() {
        let field = |request| watch_from_wire(request).expect_err("wrong").field;
        let region = Some(v1::CellBox::default());
        assert_eq!(field(v1::WatchAnomaliesRequest { region, ..Default::default() }), "region");
        let location = "a/b".to_owned();
        assert_eq!(field(v1::WatchAnomaliesRequest { location, ..Default::default() }), "location");
        assert_eq!(field(v1::WatchAnomaliesRequest { confidence: Some(0.2), ..Default::default() }), "confidence");
    }

    #[test]
    fn the_columns_of_anomalies_are_of_equal_length() {
        let anomaly = |utc_nanos, value, probability| Anomaly { utc_nanos, value, probability };
        let found = [anomaly(5, 1.0, 0.01), anomaly(9, 0.0, 0.995)];
        let plain = anomalies_to_wire(found);
        assert_eq!((plain.times_nanos.as_slice(), plain.values.as_slice()), (&[5, 9][..], &[1.0, 0.0][..]));
        assert_eq!((plain.probabilities.as_slice(), plain.labels.len()), (&[0.01, 0.995][..], 0));
        let labelled = label_anomalies_to_wire([("eat".to_owned(), found[0]), ("cook".to_owned(), found[1])]);
        assert_eq!(labelled.labels, ["eat", "cook"]);
        assert_eq!(v1::FindAnomaliesResponse { labels: Vec::new(), ..labelled }, plain);
        let watched = watched_to_wire([("door".to_owned(), found[0])], 3);
        assert_eq!((watched.states.as_slice(), watched.missed_observations), (&["door".to_owned()][..], 3));
        assert_eq!((watched.times_nanos, watched.values, watched.probabilities), (vec![5], vec![1.0], vec![0.01]));
    }
}
