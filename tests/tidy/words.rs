//! One word, one meaning; and texts that are short enough to be read.
//!
//! Invariant: a list of exceptions only gets shorter.

use std::collections::BTreeMap;

use super::{CRATES, code, files, hold, read, sources};

const COLUMNS_MAX: usize = 120;

/// Texts that everybody reads, and the most words that each may have.
const WORDS_MAX: [(&str, usize); 2] = [("README.md", 1_300), ("ARCHITECTURE.md", 2_500)];

/// Places that may define a type of the same name.
const PLACES_MAX: usize = 2;

#[test]
fn comment_lines_are_not_wider_than_a_screen() {
    let mut broken = Vec::new();
    for path in files(".", ".rs").into_iter().chain(files(".", ".proto")) {
        for (number, line) in read(&path).lines().enumerate() {
            let columns = line.chars().count();
            if line.trim_start().starts_with("//") && columns > COLUMNS_MAX {
                broken.push(format!("{path}:{}: a comment of {columns} columns; {COLUMNS_MAX} at most", number + 1));
            }
        }
    }
    hold(&broken);
}

#[test]
fn front_pages_are_short() {
    let mut broken = Vec::new();
    for (path, words_max) in WORDS_MAX {
        let words = read(path).split_whitespace().count();
        if words > words_max {
            broken.push(format!("{path}: {words} words; {words_max} at most"));
        }
    }
    hold(&broken);
}

/// The name of the type that a line of code at the top level defines.
fn defined_type(line: &str) -> Option<&str> {
    if line.starts_with(' ') {
        return None;
    }
    let line = line.strip_prefix("pub").map_or(line, |after| match after.strip_prefix('(') {
        Some(scope) => scope.split_once(')').map_or(line, |(_, after)| after),
        None => after,
    });
    let (keyword, rest) = line.strip_prefix(' ').unwrap_or(line).split_once(' ')?;
    let name = rest.split(|character: char| !character.is_alphanumeric() && character != '_').next()?;
    matches!(keyword, "struct" | "enum" | "trait" | "type" | "union").then_some(name)
}

#[test]
fn a_type_name_has_one_meaning() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (folder, ..) in
        CRATES.iter().filter(|&&(folder, ..)| !matches!(folder, "server/layout" | "migrations" | "tests"))
    {
        for path in sources(folder) {
            for name in code(&read(&path)).lines().filter_map(defined_type) {
                places.entry(name.to_owned()).or_default().push(path.clone());
            }
        }
    }
    let many = places.iter().filter(|(_, places)| places.len() > PLACES_MAX);
    hold(&many.map(|(name, places)| format!("{name}: defined in {}", places.join(", "))).collect::<Vec<_>>());
}

/// The crates whose types the client library re-exports.
const DOMAIN: [&str; 5] = ["server/model", "server/grid", "server/map", "server/plan", "proto"];

/// The public types that a crate defines at the top level of its files.
fn public_types(folder: &str) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for path in sources(folder) {
        let text = code(&read(&path));
        let public = text.lines().filter(|line| line.starts_with("pub ")).filter_map(defined_type);
        found.extend(public.map(|name| (name.to_owned(), path.clone())));
    }
    found
}

#[test]
fn the_client_library_defines_no_type_of_the_domain_again() {
    let of_client = public_types("client");
    assert!(of_client.contains_key("ModelDescription"), "{of_client:?}");
    let mut broken = Vec::new();
    for (name, path) in DOMAIN.into_iter().flat_map(public_types) {
        if let Some(twin) = of_client.get(&name) {
            broken.push(format!("{twin}: {name} is defined in {path}: re-export it, or give it another name"));
        }
    }
    hold(&broken);
}

#[test]
fn only_convert_makes_wire_messages() {
    let mut broken: Vec<String> = Vec::new();
    for (folder, ..) in CRATES {
        for path in sources(folder).iter().filter(|path| !path.starts_with("proto/src/convert")) {
            for (number, line) in code(&read(path)).lines().enumerate().filter(|(_, line)| line.contains("fn to_wire"))
            {
                broken.push(format!("{path}:{}: {}; proto/src/convert does that", number + 1, line.trim()));
            }
        }
    }
    hold(&broken);
}

/// The terms of the table below "## Glossary" in ARCHITECTURE.md, with the names in backticks of their rows.
fn glossary(text: &str) -> Vec<(String, Vec<String>)> {
    let section = text.split("\n## Glossary").nth(1).and_then(|rest| rest.split("\n## ").next()).unwrap_or_default();
    let rows = section.lines().filter(|line| line.starts_with('|')).skip(2);
    rows.map(|row| {
        let term = row.trim_start_matches('|').split('|').next().unwrap_or_default();
        let names = row.split('`').skip(1).step_by(2).map(str::to_owned).collect();
        (term.trim().trim_matches('*').to_lowercase(), names)
    })
    .collect()
}

#[test]
fn the_glossary_has_each_term_once() {
    let glossary = glossary(&read("ARCHITECTURE.md"));
    assert!(!glossary.is_empty(), "ARCHITECTURE.md has no table below \"## Glossary\"");
    let code: String = CRATES.iter().flat_map(|(folder, ..)| sources(folder)).map(|path| read(&path)).collect();
    let mut broken = Vec::new();
    for (at, (term, names)) in glossary.iter().enumerate() {
        if glossary[..at].iter().any(|(before, _)| before == term) {
            broken.push(format!("ARCHITECTURE.md: the glossary has {term:?} twice"));
        }
        let missing = names.iter().filter(|name| name.split("::").any(|part| !code.contains(part)));
        broken.extend(missing.map(|name| format!("ARCHITECTURE.md: {term:?} is not called `{name}` in the code")));
    }
    hold(&broken);
}

#[test]
fn the_rules_of_words_can_fail() {
    assert_eq!(defined_type("pub(crate) struct Header {"), Some("Header"));
    assert_eq!(defined_type("pub enum Kind<T> {"), Some("Kind"));
    assert_eq!(defined_type("type Row = Vec<u8>;"), Some("Row"));
    assert_eq!(defined_type("    type Item = u8;"), None);
    assert_eq!(defined_type("public struct"), None);
    let text = "# A\n## Glossary\n\n| term | code |\n|---|---|\n| **Log** | `MapLog` |\n| day | `Day`, `x::Y` |\n\n## B\n| c | `d` |\n";
    let terms = glossary(text);
    assert_eq!(terms[0], ("log".to_owned(), vec!["MapLog".to_owned()]));
    assert_eq!(terms[1], ("day".to_owned(), vec!["Day".to_owned(), "x::Y".to_owned()]));
    assert_eq!(terms.len(), 2);
}
