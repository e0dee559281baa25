//! The states that a command means: names, patterns of names, or all.
//!
//! Invariant: a pattern that no name fits is reported, with names that exist.

use tidemap_client::maps::State;

use crate::commands::{Session, usage};
pub(crate) use tidemap_formats::pattern::matches;

/// Whether a name may be a pattern.
fn is_pattern(name: &str) -> bool {
    name.contains(['*', '?'])
}

/// All states of a map, in the order of their first observation.
pub(crate) async fn states(session: &Session, map: &str) -> anyhow::Result<Vec<State>> {
    let mut all = Vec::new();
    let mut token = Some(String::new());
    while let Some(page_token) = token {
        let (states, next) = session.client.states(map, &page_token).await?;
        all.extend(states);
        token = next;
    }
    Ok(all)
}

/// All names of a map, in the order of their first observation.
pub(crate) async fn all(session: &Session, map: &str) -> anyhow::Result<Vec<String>> {
    Ok(states(session, map).await?.into_iter().map(|state| state.name).collect())
}

/// The selected names: patterns are replaced by the names that fit, in their order; without any, all names.
pub(crate) async fn meant(session: &Session, map: &str, names: Vec<String>) -> anyhow::Result<Vec<String>> {
    if !names.is_empty() && !names.iter().any(|name| is_pattern(name)) {
        return Ok(names);
    }
    let known = all(session, map).await?;
    if names.is_empty() {
        return if known.is_empty() { Err(usage(format!("map {map:?} has no states yet"))) } else { Ok(known) };
    }
    let mut meant: Vec<String> = Vec::new();
    for name in names {
        // A name may have the characters of a pattern.
        if !is_pattern(&name) || known.contains(&name) {
            meant.push(name);
            continue;
        }
        let pattern: Vec<char> = name.chars().collect();
        let found = known.iter().filter(|known| matches(&pattern, &known.chars().collect::<Vec<_>>()));
        let before = meant.len();
        meant.extend(found.cloned());
        if meant.len() == before {
            let some: Vec<&str> = known.iter().take(5).map(String::as_str).collect();
            let more = if known.len() > some.len() { ", …" } else { "" };
            return Err(usage(format!("no state of map {map:?} fits {name:?}; there are {}{more}", some.join(", "))));
        }
    }
    let mut seen = std::collections::HashSet::new();
    meant.retain(|name| seen.insert(name.clone()));
    Ok(meant)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_stand_for_any_characters_or_one() {
        let is_match = |pattern: &str, name: &str| {
            matches(&pattern.chars().collect::<Vec<_>>(), &name.chars().collect::<Vec<_>>())
        };
        for (pattern, name, expected) in [
            ("door-*", "door-1", true),
            ("door-*", "door-", true),
            ("door-*", "floor-1", false),
            ("*kitchen*", "the kitchen door", true),
            ("s?", "s1", true),
            ("s?", "s12", false),
            ("*", "", true),
            ("a*b*c", "a-b-b-c", true),
            ("a*b*c", "a-c-b", false),
        ] {
            assert_eq!(is_match(pattern, name), expected, "{pattern} {name}");
        }
    }
}
