//! What is explored, by which strategies and models, as a file says.
//!
//! Invariant: a protocol that was read can be run on every world that has enough weeks. Paths are relative to its file.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;
use tidemap_map::time::parse_duration;

use super::{
    ExploreProtocol,
    belief::BeliefModel,
    office::{OfficeProtocol, RawOffice},
    replay::VisitStrategy,
};
use crate::{
    ProtocolError,
    place_recording::DAY_MINUTES,
    protocol::raw::{Word, Words},
};

/// Longest protocol.
const FILE_BYTES_MAX: u64 = 1024 * 1024;
/// Most seeds.
const SEEDS_MAX: u64 = 1000;
/// Slots when nothing is said (RAS 2017, section 7).
const SLOT_MINUTES: usize = 10;
const WORLD: &str = "the file of the world, with rows of FROM UNTIL PLACE in minutes";
const OUT: &str = "the folder that results are written to";
const MINUTE_NANOS: i64 = 60 * 1_000_000_000;

/// What a protocol says.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacesProtocol {
    /// Of the experiment.
    pub name: String,
    /// The recording.
    pub world: PathBuf,
    /// Length of a slot; it divides the day.
    pub slot_minutes: usize,
    /// The share of slots that may be used to look, 0 to 1.
    pub exploration: f64,
    /// How many times each pair is run, with seeds from 0 on.
    pub seeds: u64,
    /// First and last week, from 1, that are also scored apart.
    pub weeks: Option<(usize, usize)>,
    /// Strategies, at least one.
    pub plans: Vec<VisitStrategy>,
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
    exploration: Option<Word>,
    seeds: Option<Word>,
    weeks: Option<Words>,
    strategies: Option<Words>,
    models: Option<Words>,
    out: Option<Word>,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, what was found and what would be right.
pub fn read(path: &Path) -> Result<ExploreProtocol, ProtocolError> {
    let length = fs::metadata(path)?.len();
    if length > FILE_BYTES_MAX {
        return Err(ProtocolError::TooLong { found: length, most: FILE_BYTES_MAX });
    }
    let stem = path.file_stem().map_or_else(|| "exploration".into(), |stem| stem.to_string_lossy());
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    parse(&fs::read_to_string(path)?, &stem, folder)
}

/// Makes a protocol of a text; `name` is used where it says none.
pub fn parse(text: &str, name: &str, folder: &Path) -> Result<ExploreProtocol, ProtocolError> {
    let mut written: RawExploreProtocol = serde_saphyr::from_str(text).map_err(|error| ProtocolError::yaml(&error))?;
    match written.office.take() {
        Some(office) => of_office(office, written, name, folder).map(ExploreProtocol::Office),
        None => of_places(written, name, folder).map(ExploreProtocol::Places),
    }
}

/// An office, of which strategies and models are not chosen.
fn of_office(
    office: RawOffice,
    written: RawExploreProtocol,
    name: &str,
    folder: &Path,
) -> Result<OfficeProtocol, ProtocolError> {
    const RIGHT: &str = "left out beside an office, which is a world of its own";
    let one = [("world", written.world), ("slot", written.slot), ("exploration", written.exploration)];
    let lists = [("weeks", written.weeks), ("strategies", written.strategies), ("models", written.models)];
    let first = |words: Words| Word {
        line: words.line,
        text: words.words.into_iter().map(|word| word.text).collect::<Vec<_>>().join(", "),
    };
    let mut others = one.into_iter().chain(lists.map(|(key, words)| (key, words.map(first))));
    if let Some((key, word)) = others.find_map(|(key, word)| Some((key, word?))) {
        return Err(ProtocolError::value(key, &word, RIGHT));
    }
    let name = written.name.map_or_else(|| name.to_owned(), |word| word.text);
    office.parse(name, seeds(written.seeds)?, path(written.out, "out", OUT, folder)?)
}

fn of_places(written: RawExploreProtocol, name: &str, folder: &Path) -> Result<PlacesProtocol, ProtocolError> {
    let slot_minutes = written.slot.map_or(Ok(SLOT_MINUTES), |word| {
        let minutes = parse_duration(&word.text).ok().and_then(|nanos| {
            let minutes = usize::try_from(nanos / MINUTE_NANOS).ok().filter(|_| nanos % MINUTE_NANOS == 0)?;
            (minutes > 0 && DAY_MINUTES.is_multiple_of(minutes)).then_some(minutes)
        });
        minutes.ok_or_else(|| ProtocolError::value("slot", &word, "whole minutes that divide the day, such as 10m"))
    })?;
    let exploration = written.exploration.map_or(Ok(0.5), |word| {
        let ratio = word.text.parse().ok().filter(|ratio: &f64| (0.0..=1.0).contains(ratio));
        ratio.ok_or_else(|| ProtocolError::value("exploration", &word, "the share of slots to look in, from 0 to 1"))
    })?;
    let plan = |word: &Word| VisitStrategy::ALL.into_iter().find(|plan| plan.name() == word.text);
    let plans = named("strategies", written.strategies, plan, &VisitStrategy::ALL.map(|plan| plan.name().to_owned()))?;
    let model = |word: &Word| BeliefModel::all().find(|model| model.name() == word.text);
    let models =
        named("models", written.models, model, &BeliefModel::all().map(BeliefModel::name).collect::<Vec<_>>())?;
    Ok(PlacesProtocol {
        name: written.name.map_or_else(|| name.to_owned(), |word| word.text),
        world: path(written.world, "world", WORLD, folder)?,
        slot_minutes,
        exploration,
        seeds: seeds(written.seeds)?,
        weeks: written.weeks.as_ref().map(weeks).transpose()?,
        plans,
        models,
        out: path(written.out, "out", OUT, folder)?,
    })
}

fn seeds(word: Option<Word>) -> Result<u64, ProtocolError> {
    word.map_or(Ok(5), |word| {
        let seeds = word.text.parse().ok().filter(|seeds| (1..=SEEDS_MAX).contains(seeds));
        seeds.ok_or_else(|| ProtocolError::value("seeds", &word, "a number of runs from 1 to 1000"))
    })
}

/// A path relative to a folder.
fn path(word: Option<Word>, key: &'static str, right: &str, folder: &Path) -> Result<PathBuf, ProtocolError> {
    match word {
        Some(word) if word.text.is_empty() => Err(ProtocolError::value(key, &word, right)),
        Some(word) => Ok(folder.join(word.text)),
        None => Err(ProtocolError::missing(key, right)),
    }
}

/// Each of what can be named, once.
fn named<T: Copy + PartialEq>(
    key: &'static str,
    words: Option<Words>,
    find: impl Fn(&Word) -> Option<T>,
    names: &[String],
) -> Result<Vec<T>, ProtocolError> {
    let right = format!("one of: {}", names.join(", "));
    let words = words.map_or_else(Vec::new, |words| words.words);
    if words.is_empty() {
        return Err(ProtocolError::missing(key, &format!("a list of {key}, each {right}")));
    }
    let mut found: Vec<T> = Vec::with_capacity(words.len());
    for word in &words {
        let one = find(word).ok_or_else(|| ProtocolError::value(key, word, &right))?;
        if found.contains(&one) {
            return Err(ProtocolError::value(key, word, "each once"));
        }
        found.push(one);
    }
    Ok(found)
}

fn weeks(written: &Words) -> Result<(usize, usize), ProtocolError> {
    const RIGHT: &str = "the first and the last week to score apart, such as [3, 8]";
    let number = |word: &Word| word.text.parse().ok().filter(|week| (1..=10_000_usize).contains(week));
    match &written.words[..] {
        [first, last] => {
            let from = number(first).ok_or_else(|| ProtocolError::value("weeks", first, RIGHT))?;
            let until = number(last).filter(|until| *until >= from);
            Ok((from, until.ok_or_else(|| ProtocolError::value("weeks", last, RIGHT))?))
        }
        words => {
            let text = words.iter().map(|word| word.text.as_str()).collect::<Vec<_>>().join(", ");
            Err(ProtocolError::value("weeks", &Word { line: written.line, text }, RIGHT))
        }
    }
}
