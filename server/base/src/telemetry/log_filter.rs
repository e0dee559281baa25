//! The setting `log_level`, which selects the logged events.
//!
//! Invariant: an accepted filter logs the parts that it names. `EnvFilter` alone takes a misspelled level for the name
//! of a part of the program. It then logs only this part, which does not exist.

use anyhow::{Context as _, ensure};
use tracing_subscriber::EnvFilter;

const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];

/// The parts of a filter: they are separated by commas outside of brackets.
fn directives(filter: &str) -> Vec<&str> {
    let mut depth = 0_usize;
    filter
        .split(|letter: char| {
            match letter {
                '[' | '{' => depth += 1,
                ']' | '}' => depth = depth.saturating_sub(1),
                _ => {}
            }
            letter == ',' && depth == 0
        })
        .map(str::trim)
        .collect()
}

fn is_level(word: &str) -> bool {
    LEVELS.iter().any(|level| level.eq_ignore_ascii_case(word))
}

/// The target and the level of a part that is not a level alone. A span in brackets may contain any text.
fn target_and_level(directive: &str) -> Option<(&str, &str)> {
    let after_span = directive.rfind(']').map_or(0, |at| at + 1);
    let (_, level) = directive.get(after_span..)?.rsplit_once('=')?;
    let target = directive.split(['=', '[']).next()?;
    Some((target, level))
}

/// The filter that `log_level` means.
///
/// # Errors
/// A part is neither a level nor a level of a part of the program, or nothing of the daemon would be logged.
pub(super) fn parse(filter: &str) -> anyhow::Result<EnvFilter> {
    let advice = "it must be off, error, warn, info, debug or trace, or a filter such as info,tidemap_ingest=debug";
    let mut names_daemon = false;
    for directive in directives(filter) {
        if is_level(directive) {
            names_daemon = true;
            continue;
        }
        let known = target_and_level(directive).filter(|(_, level)| is_level(level));
        let Some((target, _)) = known else {
            anyhow::bail!("setting log_level is {filter:?}, and {directive:?} is no level: {advice}");
        };
        // A span without a target matches every part of the program.
        names_daemon |= target.is_empty() || target.starts_with("tidemap");
    }
    ensure!(
        names_daemon,
        "setting log_level is {filter:?}, which names no part of the daemon, so that nothing would be logged: {advice}"
    );
    EnvFilter::try_new(directives(filter).join(","))
        .with_context(|| format!("setting log_level is {filter:?}: {advice}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_that_is_no_level_is_refused() {
        let refused = [
            "inf",
            "infos",
            "verbose",
            "all",
            "none",
            "",
            " ",
            ",",
            "info,",
            "info,debg",
            "tidemapd",
            "tidemapd=inf",
            "tidemapd=",
            "=info",
            "info,tidemap_ingest=debgu",
            "info debug",
            "info;debug",
            "tidmapd=debug",
            "h2=trace",
            "[request]",
            "[request{map=office}]=verbose",
            "warn=tidemapd",
        ];
        for filter in refused {
            let error = parse(filter).expect_err(filter).to_string();
            assert!(error.contains("log_level") && error.contains("error, warn, info"), "{filter}: {error}");
        }
        let error = parse("info,debg").expect_err("no level").to_string();
        assert!(error.contains("\"debg\" is no level"), "{error}");
    }

    #[test]
    fn levels_and_levels_of_parts_are_taken() {
        let taken = [
            "off",
            "error",
            "warn",
            "info",
            "debug",
            "trace",
            "INFO",
            "Warn",
            "tidemapd=debug",
            "info,h2=off",
            "info,tidemap_ingest=debug",
            "info, tidemap_ingest=debug",
            "tidemap_store=trace,warn",
            "[request]=debug",
        ];
        for filter in taken {
            parse(filter).unwrap_or_else(|error| panic!("{filter}: {error:#}"));
        }
    }
}
