//! The models of a protocol, each with the parameter sets that its lists of values span.
//!
//! A name may end in a suffix that draws predictions to the newest reading, as on the command line (`spectral+memory`);
//! [`ModelSelector`] defines the suffixes.
//!
//! Invariant: an entry has at least one parameter set, and several only if the protocol tunes. Sets are in the order of
//! the lists; the last parameter changes fastest.

use tidemap_model::{
    StateKind,
    catalogue::{ModelKind, SupportedStates, WrongParameter},
    selector::ModelSelector,
};

use super::{
    super::compared::{ComparableKind, ComparedSettings},
    EACH, Lists,
    error::ProtocolError,
    raw::{RawModel, Word, Words},
};

/// Maximum number of parameter sets of one model.
const PARAMETER_SETS_MAX: usize = 10_000;
/// Maximum number of models; each is compared with each.
const MODELS_MAX: usize = 100;
/// The key that sets the display name of a model; not a model parameter.
const NAME: &str = "name";

/// A model of a comparison.
#[derive(Clone, Debug)]
pub struct ModelEntry {
    /// The name of the model in results: the name of its kind, unless the protocol sets another.
    pub label: String,
    /// The parameter sets of the model; tuning chooses one.
    pub sets: Vec<ComparedSettings>,
}

/// The settings of models that the rest of a protocol allows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allowed {
    /// The kind of the values.
    pub values: StateKind,
    /// Whether a section chooses from lists.
    pub tunes: bool,
    /// The purpose of lists.
    pub lists: Lists,
    /// Whether readings are predicted from a newest one.
    pub has_newest: bool,
}

/// Reads the models.
pub(crate) fn read(models: Option<Vec<RawModel>>, allowed: Allowed) -> Result<Vec<ModelEntry>, ProtocolError> {
    let models = models.filter(|models| !models.is_empty());
    let models =
        models.ok_or_else(|| ProtocolError::missing("models", "a list of models, such as [mean, spectral]"))?;
    let mut entries: Vec<ModelEntry> = Vec::with_capacity(models.len());
    for model in &models {
        let entry = entry(model, allowed)?;
        for entry in of_lists(entry, allowed.lists) {
            if entries.iter().any(|other| other.label == entry.label) {
                let wrong = format!(
                    "two models have the name {:?}: set another name, as in {}: {{name: other}}",
                    entry.label, model.kind.text
                );
                return Err(ProtocolError::model(model.kind.line, &model.kind, wrong));
            }
            entries.push(entry);
        }
        if allowed.lists == Lists::Each && entries.len() > MODELS_MAX {
            let wrong = format!("with its lists, there are more than {MODELS_MAX} models: shorten them");
            return Err(ProtocolError::model(model.kind.line, &model.kind, wrong));
        }
    }
    Ok(entries)
}

/// The entry, or one for each of its parameter sets, which are then part of the names.
fn of_lists(entry: ModelEntry, lists: Lists) -> Vec<ModelEntry> {
    match lists {
        Lists::Each if entry.sets.len() > 1 => {
            let label = |set: &ComparedSettings| format!("{} {}", entry.label, set.shown());
            entry.sets.iter().map(|set| ModelEntry { label: label(set), sets: vec![set.clone()] }).collect()
        }
        Lists::Each | Lists::Tuned => vec![entry],
    }
}

/// The kind of a model, and how its predictions are drawn towards the newest reading.
fn kind(written: &Word, has_newest: bool) -> Result<(ComparableKind, ModelSelector), ProtocolError> {
    let (name, suffix) = written.text.split_at(written.text.find('+').unwrap_or(written.text.len()));
    let kind = ComparableKind::all().find(|kind| kind.name() == name).ok_or_else(|| {
        let names: Vec<_> = ComparableKind::all().map(ComparableKind::name).collect();
        ProtocolError::value("model", written, &format!("one of: {}", names.join(", ")))
    })?;
    if suffix.is_empty() {
        return Ok((kind, ModelSelector::default()));
    }
    // The mean of two models is no model of the catalogue, but takes the same suffixes.
    let of_catalogue = match kind {
        ComparableKind::One(kind) => kind,
        ComparableKind::Average => ModelKind::Mean,
    };
    let blend: Result<ModelSelector, _> = format!("{}{suffix}", of_catalogue.name()).parse();
    let blend = blend.map_err(|wrong| ProtocolError::model(written.line, written, wrong.to_string()))?;
    if of_catalogue.takes_newest() {
        let wrong = format!("{name} uses the newest reading as it is: leave out {suffix}");
        return Err(ProtocolError::model(written.line, written, wrong));
    }
    if !has_newest {
        let wrong = format!(
            "{suffix} draws predictions towards the newest reading, and nothing specifies which reading that is: write \
             how far ahead to predict in a comparison, as in ahead: [next, 1h, 24h], or leave it out"
        );
        return Err(ProtocolError::model(written.line, written, wrong));
    }
    Ok((kind, blend))
}

fn entry(model: &RawModel, allowed: Allowed) -> Result<ModelEntry, ProtocolError> {
    let Allowed { values, tunes, lists, has_newest } = allowed;
    let written = &model.kind;
    let (kind, blend) = kind(written, has_newest)?;
    let names = kind.parameters();
    let is_of_counts = |kind: ModelKind| kind.info().states == SupportedStates::Counts;
    if matches!(kind, ComparableKind::One(kind) if is_of_counts(kind)) && values != StateKind::Count {
        let wrong = "it is a model of counts: write kind: count, or leave it out";
        return Err(ProtocolError::model(written.line, written, wrong));
    }
    let mut label = written.text.clone();
    let mut axes: Vec<(&'static str, &Words)> = Vec::new();
    for (parameter, values) in &model.parameters {
        if parameter.text == NAME {
            label = name(values)?;
            continue;
        }
        let name = parameter_named(&names, written, parameter)?;
        if values.words.is_empty() {
            let wrong = format!("{name} is an empty list: write a value, or several to choose from");
            return Err(ProtocolError::model(values.line, written, wrong));
        }
        if values.words.len() > 1 && !tunes && lists == Lists::Tuned {
            let wrong = format!(
                "{name} lists {} values and nothing chooses one: write tuning: {{folds: 4, fold: 7d}}, or one value, \
                 or lists: {EACH} to compare all",
                values.words.len()
            );
            return Err(ProtocolError::model(values.line, written, wrong));
        }
        axes.push((name, values));
    }
    let sets = combinations(written, &axes)?;
    let set = |chosen: &Combination<'_>| Ok(parameter_set(kind, written, chosen)?.blended(blend));
    let sets = sets.iter().map(set).collect::<Result<_, ProtocolError>>()?;
    Ok(ModelEntry { label, sets })
}

fn name(values: &Words) -> Result<String, ProtocolError> {
    match &values.words[..] {
        [word] if !word.text.is_empty() => Ok(word.text.clone()),
        words => {
            let text = words.iter().map(|word| word.text.as_str()).collect::<Vec<_>>().join(", ");
            Err(ProtocolError::value(NAME, &Word { line: values.line, text }, "one word as the name of the model"))
        }
    }
}

fn parameter_named(names: &[&'static str], model: &Word, parameter: &Word) -> Result<&'static str, ProtocolError> {
    names.iter().find(|name| **name == parameter.text).copied().ok_or_else(|| {
        let has = match names {
            [] => format!("it has none but {NAME}"),
            names => format!("use {} or {NAME}", names.join(", ")),
        };
        ProtocolError::model(parameter.line, model, format!("{:?} is not a parameter of it: {has}", parameter.text))
    })
}

type Combination<'a> = Vec<(&'static str, &'a Word)>;

/// All combinations of one value for each parameter.
fn combinations<'a>(model: &Word, axes: &[(&'static str, &'a Words)]) -> Result<Vec<Combination<'a>>, ProtocolError> {
    let count = axes.iter().try_fold(1, |count: usize, (_, values)| count.checked_mul(values.words.len()));
    if count.is_none_or(|count| count > PARAMETER_SETS_MAX) {
        let wrong = format!("its lists span more than {PARAMETER_SETS_MAX} combinations: shorten them");
        return Err(ProtocolError::model(model.line, model, wrong));
    }
    let mut chosen: Vec<Combination<'a>> = vec![Vec::new()];
    for &(name, values) in axes {
        let with = |chosen: &Combination<'a>, word| chosen.iter().copied().chain([(name, word)]).collect();
        chosen = chosen.iter().flat_map(|one| values.words.iter().map(|word| with(one, word))).collect();
    }
    Ok(chosen)
}

fn parameter_set(
    kind: ComparableKind,
    model: &Word,
    chosen: &[(&'static str, &Word)],
) -> Result<ComparedSettings, ProtocolError> {
    let parameters: Vec<(&'static str, &str)> = chosen.iter().map(|&(name, word)| (name, word.text.as_str())).collect();
    ComparedSettings::new(kind, &parameters).map_err(|wrong| match wrong {
        WrongParameter::Value { name, right } => match chosen.iter().find(|(given, _)| *given == name) {
            Some((_, word)) => ProtocolError::value(&format!("{name} of {}", model.text), word, &right),
            None => ProtocolError::model(model.line, model, format!("{name} has to be {right}")),
        },
        WrongParameter::Together(wrong) => {
            let line = chosen.first().map_or(model.line, |(_, word)| word.line);
            ProtocolError::model(line, model, wrong)
        }
    })
}
