//! One catalogue of models: the definition of a kind is written down in few places, so that a kind is added in few
//! places.
//!
//! Invariant: counts code only. The files that implement a kind, in `server/model/src/models/`, are not counted.

use tidemap_client::queries::ModelKind;

use super::{CRATES, code, files, hold, read, sources};

/// Files that may name a kind of models that is trained on readings: the catalogue and the list of the implementations,
/// the wire, Python and the page, and what is stored.
const FILES_MAX: usize = 8;

/// Names of kinds that are also words for something else: of these only qualified names count.
const WORDS: [&str; 4] = ["persistence", "histogram", "uniform", "calibrated"];

/// The files that a new kind may have to be added to.
fn product() -> Vec<(String, String)> {
    let rust =
        CRATES.iter().filter(|(folder, ..)| !folder.starts_with("tests")).flat_map(|(folder, ..)| sources(folder));
    let rust = rust.chain(sources("client/python")).filter(|path| !path.starts_with("server/model/src/models/"));
    let rust = rust.map(|path| {
        let text = code(&read(&path));
        (path, text)
    });
    let page = files("client/web/src", ".ts").into_iter().chain(files("client/web/src", ".svelte"));
    let page = page.filter(|path| !path.starts_with("client/web/src/wire/"));
    let python = files("client/python/python", ".py");
    let others = files("proto", ".proto").into_iter().chain(page).chain(python);
    rust.chain(others.map(|path| (path.clone(), read(&path)))).collect()
}

/// The code without what stands between quotation marks.
fn without_texts(code: &str) -> String {
    code.split('"').step_by(2).collect::<Vec<_>>().join("\"\"")
}

/// Whether a text has a name, not as a part of a longer one.
fn has_name(text: &str, name: &str) -> bool {
    let is_of_name = |character: char| character.is_alphanumeric() || character == '_';
    text.match_indices(name).any(|(at, _)| {
        let (before, after) = (text[..at].chars().next_back(), text[at + name.len()..].chars().next());
        !before.is_some_and(is_of_name) && !after.is_some_and(is_of_name)
    })
}

/// Whether a file names a kind: as a variant or constant, on the wire, as a text of its own, or as an identifier.
fn names(path: &str, text: &str, kind: &str) -> bool {
    let capitals = kind.to_uppercase().replace('-', "_");
    let snake = kind.replace('-', "_");
    let camel: String = kind.split('-').map(|part| part[..1].to_uppercase() + &part[1..]).collect();
    let qualified = [
        format!("ModelKind::{camel}"),
        format!("ModelKind::{capitals}"),
        format!("ModelKind.{capitals}"),
        format!("MODEL_KIND_{capitals}"),
        format!("TrainedModel::{camel}"),
        format!("TrainedModelParts::{camel}"),
    ];
    let is_identifier =
        |name: &str| path.ends_with(".rs") && !WORDS.contains(&kind) && has_name(&without_texts(text), name);
    // In Rust these words are also names of fields and suffixes.
    let is_text = !(path.ends_with(".rs") && WORDS.contains(&kind)) && text.contains(&format!("\"{kind}\""));
    is_text
        || qualified.iter().any(|name| has_name(text, name))
        || [camel, snake].iter().any(|name| is_identifier(name))
}

#[test]
fn a_kind_of_models_is_named_in_few_files() {
    let product = product();
    let mut broken = Vec::new();
    for kind in ModelKind::ALL.into_iter().filter(|kind| kind.needs_readings()) {
        let found: Vec<&str> = product
            .iter()
            .filter(|(path, text)| names(path, text, kind.name()))
            .map(|(path, _)| path.as_str())
            .collect();
        // The catalogue, the wire and the page name every kind: with fewer, this test would not see names any more.
        assert!(found.len() >= 4, "{}: {found:?}", kind.name());
        if found.len() > FILES_MAX {
            let list = found.join(", ");
            broken.push(format!("{}: {} files name it, {FILES_MAX} at most: {list}", kind.name(), found.len()));
        }
    }
    hold(&broken);
}
