//! The protocol of an exploration: a recorded world with strategies and models, or a simulated office.
//!
//! Invariant: a protocol that was read can be run on every recording with enough weeks. Paths are relative to its file.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use tidemap_model::time::parse_duration;

use super::{
    ExploreProtocol,
    belief::BeliefModel,
    office::{OfficeProtocol, RawOffice},
    replay::{VisitStrategy, VisitWorth},
};
use crate::{
    ProtocolError,
    place_recording::DAY_MINUTES,
    protocol::{
        OUT,
        keys::{ProtocolFile, from_yaml, parsed, required, whole},
        raw::{Word, Words},
    },
};

/// Maximum number of seeds.
const SEEDS_MAX: u64 = 1000;
/// Default length of a slot (RAS 2017, section 7).
const SLOT_MINUTES: usize = 10;
const WORLD: &str = "the file of the world, with rows of FROM UNTIL PLACE in minutes";
const MINUTE_NANOS: i64 = 60 * 1_000_000_000;

/// The protocol of an exploration of a recorded world.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacesProtocol {
    /// Name of the experiment.
    pub name: String,
    /// The file of the recording.
    pub world: PathBuf,
    /// Length of a slot, which divides the day.
    pub slot_minutes: usize,
    /// The shares of slots that may be used for visits, each 0 to 1, at least one.
    pub explorations: Vec<f64>,
    /// Number of runs of each strategy with each model, with seeds from 0 on.
    pub seeds: u64,
    /// First and last week, from 1, that are also scored separately.
    pub weeks: Option<(usize, usize)>,
    /// Strategies, at least one.
    pub strategies: Vec<VisitStrategy>,
    /// The measures of the worth of a visit, at least one.
    pub worths: Vec<VisitWorth>,
    /// Models, at least one.
    pub models: Vec<BeliefModel>,
    /// Folder of the results.
    pub out: PathBuf,
}

/// The file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawExploreProtocol {
    name: Option<Word>,
    world: Option<Word>,
    office: Option<RawOffice>,
    slot: Option<Word>,
    exploration: Option<Words>,
    seeds: Option<Word>,
    weeks: Option<Words>,
    strategies: Option<Words>,
    information: Option<Words>,
    models: Option<Words>,
    out: Option<Word>,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, the value found and the values allowed.
pub fn read(path: &Path) -> Result<ExploreProtocol, ProtocolError> {
    let file = ProtocolFile::read(path)?;
    parse(&file.text, &file.name, &file.folder)
}

/// Parses a protocol; `name` is its name if the text has none.
pub(super) fn parse(text: &str, name: &str, folder: &Path) -> Result<ExploreProtocol, ProtocolError> {
    let mut written: RawExploreProtocol = from_yaml(text)?;
    match written.office.take() {
        Some(office) => of_office(office, written, name, folder).map(ExploreProtocol::Office),
        None => of_places(written, name, folder).map(ExploreProtocol::Places),
    }
}

/// An office; its strategies and models are fixed.
fn of_office(
    office: RawOffice,
    written: RawExploreProtocol,
    name: &str,
    folder: &Path,
) -> Result<OfficeProtocol, ProtocolError> {
    const RIGHT: &str = "left out beside an office, which is a world of its own";
    let one = [("world", written.world), ("slot", written.slot)];
    let lists = [
        ("exploration", written.exploration),
        ("weeks", written.weeks),
        ("strategies", written.strategies),
        ("information", written.information),
        ("models", written.models),
    ];
    let first = |words: Words| Word {
        line: words.line,
        text: words.words.into_iter().map(|word| word.text).collect::<Vec<_>>().join(", "),
    };
    let mut others = one.into_iter().chain(lists.map(|(key, words)| (key, words.map(first))));
    if let Some((key, word)) = others.find_map(|(key, word)| Some((key, word?))) {
        return Err(ProtocolError::value(key, &word, RIGHT));
    }
    let name = written.name.map_or_else(|| name.to_owned(), |word| word.text);
    office.parse(name, seeds(written.seeds)?, folder.join(required(written.out, "out", OUT)?.text))
}

fn of_places(written: RawExploreProtocol, name: &str, folder: &Path) -> Result<PlacesProtocol, ProtocolError> {
    let slot_minutes = written.slot.map_or(Ok(SLOT_MINUTES), |word| {
        parsed(&word, "slot", "whole minutes that divide the day, such as 10m", |text| {
            let nanos = parse_duration(text).ok()?;
            let minutes = usize::try_from(nanos / MINUTE_NANOS).ok().filter(|_| nanos % MINUTE_NANOS == 0)?;
            (minutes > 0 && DAY_MINUTES.is_multiple_of(minutes)).then_some(minutes)
        })
    })?;
    let strategies = VisitStrategy::ALL.into_iter().map(|strategy| (strategy.name().to_owned(), strategy));
    let worths = VisitWorth::all().map(|worth| (worth.name().to_owned(), worth));
    let worths = match written.information {
        Some(information) => named("information", Some(information), &worths.collect::<Vec<_>>())?,
        None => vec![VisitWorth::Entropy],
    };
    let models = BeliefModel::all().map(|model| (model.name(), model));
    Ok(PlacesProtocol {
        name: written.name.map_or_else(|| name.to_owned(), |word| word.text),
        world: folder.join(required(written.world, "world", WORLD)?.text),
        slot_minutes,
        explorations: written.exploration.as_ref().map_or_else(|| Ok(vec![0.5]), explorations)?,
        seeds: seeds(written.seeds)?,
        weeks: written.weeks.as_ref().map(weeks).transpose()?,
        strategies: named("strategies", written.strategies, &strategies.collect::<Vec<_>>())?,
        worths,
        models: named("models", written.models, &models.collect::<Vec<_>>())?,
        out: folder.join(required(written.out, "out", OUT)?.text),
    })
}

/// The shares of slots for visits, each once.
fn explorations(written: &Words) -> Result<Vec<f64>, ProtocolError> {
    const KEY: &str = "exploration";
    const RIGHT: &str = "the share of slots for visits, from 0 to 1, or a list of such shares";
    if written.words.is_empty() {
        return Err(ProtocolError::value(KEY, &Word { line: written.line, text: "[]".to_owned() }, RIGHT));
    }
    let mut shares: Vec<f64> = Vec::with_capacity(written.words.len());
    for word in &written.words {
        let share = parsed(word, KEY, RIGHT, |text| text.parse().ok().filter(|share| (0.0..=1.0).contains(share)))?;
        if shares.contains(&share) {
            return Err(ProtocolError::value(KEY, word, "each share once"));
        }
        shares.push(share);
    }
    Ok(shares)
}

fn seeds(word: Option<Word>) -> Result<u64, ProtocolError> {
    word.map_or(Ok(5), |word| whole(&word, "seeds", 1..=SEEDS_MAX))
}

/// The values of a list of names, each at most once.
fn named<T: Copy + PartialEq>(
    key: &'static str,
    words: Option<Words>,
    choices: &[(String, T)],
) -> Result<Vec<T>, ProtocolError> {
    let names: Vec<&str> = choices.iter().map(|(name, _)| name.as_str()).collect();
    let right = format!("one of: {}", names.join(", "));
    let words = words.map_or_else(Vec::new, |words| words.words);
    if words.is_empty() {
        return Err(ProtocolError::missing(key, &format!("a list of {key}, each {right}")));
    }
    let mut values: Vec<T> = Vec::with_capacity(words.len());
    for word in &words {
        let find = |text: &str| choices.iter().find(|(name, _)| name == text).map(|&(_, value)| value);
        let value = parsed(word, key, &right, find)?;
        if values.contains(&value) {
            return Err(ProtocolError::value(key, word, "each once"));
        }
        values.push(value);
    }
    Ok(values)
}

fn weeks(written: &Words) -> Result<(usize, usize), ProtocolError> {
    const RIGHT: &str = "the first and the last week to score separately, such as [3, 8]";
    let number = |word: &Word, min: usize| {
        parsed(word, "weeks", RIGHT, |text| text.parse().ok().filter(|week| (min..=10_000).contains(week)))
    };
    match &written.words[..] {
        [first, last] => {
            let from = number(first, 1)?;
            Ok((from, number(last, from)?))
        }
        words => {
            let text = words.iter().map(|word| word.text.as_str()).collect::<Vec<_>>().join(", ");
            Err(ProtocolError::value("weeks", &Word { line: written.line, text }, RIGHT))
        }
    }
}
