//! Settings as a config file: the commented example, and the settings in force.
//!
//! Invariant: the text is made from the declaration of the settings, so that it cannot differ from the settings of the
//! daemon. `deploy/tidemapd.toml` is the example, and a test compares them.

use std::fmt::Write as _;

use serde_json::Value;

use super::{SECTIONS, Setting, Settings, cluster};

/// Width of the lines, in columns.
const COLUMNS: usize = 120;

const HEADER: &str = "Settings of tidemapd. Every key is listed with its default; remove the # to change one. Each key \
    is also an environment variable (TIDEMAP_DATA_DIR) and, if `tidemapd --help` lists it, a flag (--data-dir). Flags \
    override the environment, and the environment overrides this file. An unknown key is an error. This file is what \
    `tidemapd config --example` prints.";

/// Appends a text as comment lines of at most [`COLUMNS`].
fn comment(out: &mut String, text: &str) {
    let mut line = "#".to_owned();
    for word in text.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COLUMNS {
            out.push_str(&line);
            out.push('\n');
            "#".clone_into(&mut line);
        }
        line.push(' ');
        line.push_str(word);
    }
    out.push_str(&line);
    out.push('\n');
}

/// `key = value` in TOML. A JSON string is also a TOML string, because the settings have no control characters except
/// those that JSON escapes.
fn assignment(values: &Value, setting: &Setting) -> String {
    let value = values.get(setting.key).cloned().unwrap_or(Value::Null);
    match value.as_u64().filter(|_| setting.key.ends_with("_mode")) {
        Some(mode) => format!("{} = 0o{mode:03o}", setting.key),
        None => format!("{} = {value}", setting.key),
    }
}

fn range(setting: &Setting) -> String {
    match setting.range {
        Some((min, max)) if setting.key.ends_with("_mode") => format!(" From 0o{min:03o} to 0o{max:03o}."),
        Some((min, max)) => format!(" From {min} to {max}."),
        None => String::new(),
    }
}

/// The example config: every setting with its meaning, its range and its default, which is commented out.
///
/// # Errors
/// A default cannot be written as text, for example a path that is no UTF-8.
pub fn example() -> anyhow::Result<String> {
    let defaults = serde_json::to_value(Settings::default())?;
    let mut out = String::new();
    comment(&mut out, HEADER);
    for (title, settings) in SECTIONS {
        let rule = "-".repeat(COLUMNS.saturating_sub(7 + title.chars().count()));
        write!(out, "\n# --- {title} {rule}\n")?;
        for setting in *settings {
            out.push('\n');
            comment(&mut out, &format!("{}{}", setting.meaning.concat(), range(setting)));
            writeln!(out, "#{}", assignment(&defaults, setting))?;
        }
    }
    out.push_str(cluster::EXAMPLE);
    Ok(out)
}

/// The settings in force, one a line.
///
/// # Errors
/// A setting cannot be written as text, for example a path that is no UTF-8.
pub fn in_force(settings: &Settings) -> anyhow::Result<String> {
    let values = serde_json::to_value(settings)?;
    let all = SECTIONS.iter().flat_map(|(_, settings)| settings.iter());
    let mut out: String = all.map(|setting| assignment(&values, setting) + "\n").collect();
    if let Some(section) = values.get("cluster").and_then(Value::as_object) {
        out.push_str("\n[cluster]\n");
        for (key, value) in section {
            writeln!(out, "{key} = {value}")?;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use figment::{
        Figment,
        providers::{Format as _, Serialized, Toml},
    };

    use super::*;

    fn parse(text: &str) -> Settings {
        let defaults = Serialized::defaults(Settings::default());
        Figment::from(defaults).merge(Toml::string(text)).extract().expect("settings in TOML")
    }

    #[test]
    fn the_example_in_the_repository_is_the_one_of_the_code() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/tidemapd.toml");
        let kept = std::fs::read_to_string(path).expect("deploy/tidemapd.toml");
        let made = example().expect("text");
        assert!(kept == made, "run: cargo run -p tidemapd -- config --example > deploy/tidemapd.toml\n{made}");
    }

    #[test]
    fn the_example_without_comment_signs_gives_the_defaults() {
        let keys = example().expect("text");
        let (keys, cluster) = keys.split_once("# --- cluster").expect("the last section");
        let keys: Vec<&str> = keys
            .lines()
            .filter_map(|line| line.strip_prefix('#').filter(|rest| rest.starts_with(char::is_alphabetic)))
            .collect();
        assert_eq!(parse(&keys.join("\n")), Settings::default());
        let has_key = |line: &&str| line.starts_with(char::is_alphabetic) || *line == "[cluster]";
        let shown: Vec<&str> = cluster.lines().filter_map(|line| line.strip_prefix('#').filter(has_key)).collect();
        let least = parse("[cluster]\nmember = ''\nservers = []").cluster;
        assert_eq!(parse(&shown.join("\n")).cluster, least);
        let in_force = in_force(&Settings { cluster: least.clone(), ..Settings::default() }).expect("text");
        assert_eq!(parse(&in_force).cluster, least);
    }

    #[test]
    fn what_is_in_force_can_be_read_again() {
        let settings = Settings {
            data_dir: "/a \"b\"/c\\d".into(),
            http_hosts: vec!["maps.example.org".to_owned(), "b".to_owned()],
            socket_mode: 0o660,
            max_maps: 3,
            ..Settings::default()
        };
        assert_eq!(parse(&in_force(&settings).expect("text")), settings);
    }

    #[test]
    fn lines_are_not_wider_than_a_screen() {
        assert!(example().expect("text").lines().all(|line| line.chars().count() <= COLUMNS));
    }
}
