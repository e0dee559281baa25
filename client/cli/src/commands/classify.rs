//! `tidemap classify`.
//!
//! Invariant: a row for each label of the state, in their order; learned readings are durable when the command ends.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    classify::{ClassifyRequest, LearnAs, Learning},
    queries::ModelSelector,
};
use tidemap_formats::table::Cell;

use super::{Session, producer_id, times};
use crate::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct ClassifyArgs {
    /// Name of the map
    map: String,
    /// Name of a categorical state
    state: String,
    /// Likelihood of the observation for each label, at any scale; that of a label that is not named is 0
    #[arg(long = "likelihood", value_name = "LABEL=NUMBER,…", value_delimiter = ',', required = true, value_parser = likelihood)]
    likelihoods: Vec<(String, f64)>,
    /// Time of the observation [default: now]
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: Option<i64>,
    /// Place of the observation
    #[arg(long, value_name = "PLACE")]
    place: Option<String>,
    /// Model of the probabilities by time: auto, mean, latest or spectral
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Learns the likeliest label, or the share of each; also as STATE@PLACE, with a place
    #[arg(long, value_name = "label|shares", num_args = 0..=1, default_missing_value = "label", value_parser = learning)]
    learn: Option<Learning>,
    /// With --learn: name of the producer [default: a name for this user and machine, generated once and kept]
    #[arg(long, value_name = "ID", requires = "learn")]
    producer: Option<String>,
    /// With --learn: label of the producer's sequence
    #[arg(long, value_name = "LABEL", requires = "learn", default_value = "classify")]
    label: String,
    /// With --learn: number of the first reading; the command can then be repeated and is learned once [default: the
    /// next one]
    #[arg(long, value_name = "N", requires = "learn", value_parser = clap::value_parser!(u64).range(1..))]
    sequence: Option<u64>,
}

fn likelihood(text: &str) -> Result<(String, f64), String> {
    let form = || format!("{text:?} is not LABEL=NUMBER, as in sleep=0.2");
    let (label, number) = text.rsplit_once('=').ok_or_else(form)?;
    Ok((label.trim().to_owned(), number.trim().parse().map_err(|_| form())?))
}

fn learning(text: &str) -> Result<Learning, String> {
    match text {
        "label" => Ok(Learning::Label),
        "shares" => Ok(Learning::Shares),
        _ => Err(format!("{text:?} cannot be learned: use label or shares")),
    }
}

const COLUMNS: [&str; 5] = ["label", "probability", "likelihood", "temporal_prior", "spatial_prior"];

pub(crate) async fn run(session: &Session, args: ClassifyArgs) -> anyhow::Result<ExitCode> {
    let ClassifyArgs { map, state, likelihoods, at, place, model, learn, producer, label, sequence } = args;
    let learn = match learn {
        None => None,
        Some(what) => {
            let producer = producer.map_or_else(producer_id::of_user, Ok)?;
            Some(LearnAs { what, producer, label, first_sequence: sequence })
        }
    };
    let request = ClassifyRequest { state, time_nanos: at, likelihoods, place, model, learn: learn.clone() };
    let found = session.client.classify(&map, request).await?;
    let row = |known: &tidemap_client::classify::ClassifiedLabel| {
        vec![
            Cell::Text(known.label.clone()),
            known.probability.into(),
            known.likelihood.into(),
            known.temporal_prior.into(),
            Cell::maybe(known.spatial_prior),
        ]
    };
    session.print(&COLUMNS, found.labels.iter().map(row))?;
    if let Some(LearnAs { producer, label, .. }) = learn {
        let number = found.durable_sequence;
        status_line(&format!("durable up to number {number} of producer {producer}, label {label}"));
    }
    found.refusals.iter().for_each(|why| status_line(&format!("not learned: {why}")));
    Ok(if found.refusals.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[test]
fn a_likelihood_is_a_label_and_a_number() {
    assert_eq!(likelihood("sleep=0.2"), Ok(("sleep".to_owned(), 0.2)));
    assert_eq!(likelihood("a=b = 1e3"), Ok(("a=b".to_owned(), 1e3)));
    for wrong in ["sleep", "sleep=", "sleep=much"] {
        assert!(likelihood(wrong).is_err_and(|text| text.contains("LABEL=NUMBER")), "{wrong}");
    }
}
